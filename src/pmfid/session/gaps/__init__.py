"""Samples that a drive's record lacks: which they are, where they belong in time, and what stands in their place."""
