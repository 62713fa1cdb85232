"""Origins of data, with one file for each kind of source."""
