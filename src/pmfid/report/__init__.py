"""Figures and the HTML report, which need only results."""
