"""The way from a record and AXIS.toml to a result, for every kind of plant."""
