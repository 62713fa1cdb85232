"""Commands; no mathematics."""
