"""The best input within the limits, and how near it is to the optimum."""
