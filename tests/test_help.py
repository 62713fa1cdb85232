"""`help` of a user's objects explains every argument, and gives the unit of numbers."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields

import pytest

import pmfid
from pmfid.estimators.registry import ESTIMATORS

#: Objects that a user configures by hand, besides the estimators.
OBJECTS = [
    *("Along", "Drive", "Encoder", "Equation", "EquationModel", "Experiment", "Known", "Square", "Stribeck"),
    *("Term", "TransferFunction", "Wave"),
]
FUNCTIONS = [
    *("Fleet", "export_firmware", "friction_curve", "identify", "quantize", "search_terms", "validate"),
]
#: Arguments of estimators with a dimension.
UNITS = {"dt": "s", "cutoff": "rad/s", "prefilter_zeros": "rad/s", "drift_cutoff": "rad/s", "window": "s"}


def explanation(doc: str, name: str) -> str:
    """Return all explanations of an argument in a docstring, each up to the next argument."""
    return " ".join(re.findall(rf"(?:^|[^\w`]){name} ?: (.*?)(?=\s\w+ ?: |\Z)", doc, re.DOTALL))


@pytest.mark.parametrize("method", ESTIMATORS)
def test_an_estimator_explains_every_argument(method: str) -> None:
    cls = ESTIMATORS[method]
    doc = inspect.getdoc(cls) or ""
    names = [field.name for field in fields(cls) if field.init]
    assert {"model", "encoder", "dt", "cutoff", "order"} <= set(names)
    assert [name for name in names if len(explanation(doc, name)) < 5] == []
    assert [n for n, unit in UNITS.items() if n in names and f"[{unit}]" not in explanation(doc, n)] == []


@pytest.mark.parametrize("name", OBJECTS + FUNCTIONS)
def test_everything_else_names_every_argument(name: str) -> None:
    thing = getattr(pmfid, name)
    doc = inspect.getdoc(thing) or ""
    arguments = [field.name for field in fields(thing) if field.init] if name in OBJECTS else []
    arguments = arguments or list(inspect.signature(thing).parameters)
    assert [own for own in arguments if not re.search(rf"\b{own}\b", doc)] == []
