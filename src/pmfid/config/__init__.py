"""AXIS.toml: its keys, their units and their meaning."""
