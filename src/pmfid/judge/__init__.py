"""What to think of an estimate: flags, sentences and their numbers, from estimator, data and parameters."""
