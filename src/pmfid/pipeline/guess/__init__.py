"""The way from a record alone to an AXIS.toml, with a reason for each guess."""
