"""Judgements on an estimate: flags, sentences, residual tests and missing terms."""
