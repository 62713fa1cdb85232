"""What to think of an estimate: flags, sentences and the numbers behind them, from estimator, data and parameters."""
