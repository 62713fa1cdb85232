"""Receivers of estimates and alarms: one file for each kind of sink."""
