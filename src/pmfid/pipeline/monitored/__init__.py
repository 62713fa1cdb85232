"""A monitored run, from configuration and samples to estimates and events."""
