"""Transfer functions from records, off-line."""
