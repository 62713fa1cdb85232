"""Hostile input: configurations, records and names drawn at random from valid and broken parts."""
