"""Estimators: one file per method, one protocol for all."""
