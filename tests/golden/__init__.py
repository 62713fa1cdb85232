"""Outputs of every method on records of every kind, kept as text: a change of numbers shows in the diff."""
