"""Hostile input: what a configuration, a record or a name may be, drawn at random from valid and broken parts."""
