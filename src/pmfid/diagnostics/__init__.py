"""What to think of an estimate: flags, sentences, residual tests, terms that are missing."""
