"""One fit: a record is a list of observations, and one likelihood is maximised by one solver."""
