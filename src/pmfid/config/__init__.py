"""AXIS.toml: its keys, their units and what they mean."""
