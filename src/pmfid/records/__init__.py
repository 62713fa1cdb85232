"""Makes records from the columns of a file: clock, counts, gaps, wrong samples."""
