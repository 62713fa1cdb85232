"""From the columns of a file to a record: clock, counts, gaps, wrong samples."""
