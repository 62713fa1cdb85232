"""`pmfid demo`: estimators side by side on the simulated cart."""
