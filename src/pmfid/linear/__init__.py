"""Off-line estimation of transfer functions from records."""
