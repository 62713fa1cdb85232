"""The commands, without mathematics."""
