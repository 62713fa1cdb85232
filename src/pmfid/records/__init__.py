"""Records from the columns of a file: clock, counts, gaps and wrong samples."""
