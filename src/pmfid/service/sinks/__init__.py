"""Receivers of estimates and alarms, with one file for each kind of sink."""
