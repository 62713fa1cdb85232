"""From a record and AXIS.toml to a result, for every kind of plant."""
