"""Models of the plant: everything that is known before the first sample."""
