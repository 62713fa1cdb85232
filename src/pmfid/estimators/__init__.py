"""Estimators: one module per method, one protocol for all methods."""

from typing import Literal, get_args

#: Names of the methods, for code that must not import the classes; `registry.ESTIMATORS` has the classes.
Method = Literal[
    "auto",
    "fit",
    "ls",
    "bcls",
    "iv",
    "srivc",
    "rls",
    "bcrls",
    "riv",
]
Discretization = Literal["matched", "paper"]
Precision = Literal["float64", "float32"]
METHODS: tuple[Method, ...] = get_args(Method)
PRECISIONS: tuple[Precision, ...] = get_args(Precision)
