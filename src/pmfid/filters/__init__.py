"""Filters: the chain of Poisson moment functionals, its discretisations, and the columns of an equation."""
