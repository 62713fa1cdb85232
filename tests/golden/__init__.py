"""Outputs of every method on records of every kind, kept as text so that a diff shows each change of numbers."""
