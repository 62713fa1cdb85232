"""What an input is worth on a machine, and what its run tells."""
