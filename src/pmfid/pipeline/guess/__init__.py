"""The way from a record without settings to an AXIS.toml, with a reason for each guess."""
