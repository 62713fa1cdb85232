"""Equations: what is known of the plant before the first sample."""
