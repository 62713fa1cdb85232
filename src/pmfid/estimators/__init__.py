"""Estimators: one file per method, one protocol for all."""

#: Names of the methods, for those who must not import them yet; `registry.ESTIMATORS` has the classes.
METHODS = (
    "auto",
    "ls",
    "bcls",
    "known-step",
    "iv",
    "output-error",
    "interval",
    "srivc",
    "rls",
    "bcrls",
    "rknown-step",
    "riv",
    "rsrivc",
)
