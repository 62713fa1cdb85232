"""Linear processes: exact responses between samples, off-line, for any hold, spacing and gap."""
