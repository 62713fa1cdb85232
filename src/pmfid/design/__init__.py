"""Optimal inputs: the most information within the limits of the machine, and how near that is to the optimum."""
