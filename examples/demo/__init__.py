"""`pmfid demo`: several estimators on the same simulated cart."""
