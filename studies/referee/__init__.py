"""The referee: errors, intervals and status words of `identify` on random machines, right and wrong models."""
