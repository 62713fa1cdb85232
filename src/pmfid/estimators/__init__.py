"""Estimators: one module per method, one protocol for all methods."""

from typing import Literal, get_args

#: Names of the methods, for code that must not import the classes; `registry.ESTIMATORS` has the classes.
Method = Literal[
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
]
METHODS: tuple[Method, ...] = get_args(Method)
