"""Programs that compare the estimators where the truth is known."""
