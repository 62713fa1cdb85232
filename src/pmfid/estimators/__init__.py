"""Estimators: one file per method, one protocol for all."""

from typing import Literal, get_args

#: Names of the methods, for those who must not import them yet; `registry.ESTIMATORS` has the classes.
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
