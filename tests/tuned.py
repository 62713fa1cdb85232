"""Thresholds that are set for one test."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

import pytest


def set_tuning(patch: pytest.MonkeyPatch, module: ModuleType | str, **values: float) -> None:
    """Give the `TUNING` of a module's package these values until the test ends."""
    tuning = (import_module(module) if isinstance(module, str) else module).TUNING
    for name, value in values.items():
        assert hasattr(tuning, name)
        patch.setitem(vars(tuning), name, value)
