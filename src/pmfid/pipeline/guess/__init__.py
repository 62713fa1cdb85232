"""From a record alone to an AXIS.toml: each guess with its reason."""
