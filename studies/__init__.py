"""Programs that compare the estimators with the known truth."""
