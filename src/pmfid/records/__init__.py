"""Records from the columns of a file, with clock, counts, gaps and wrong samples."""
