"""The contract of estimators: the test finds every estimator and checks it against the shipped contract."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import numpy as np
import pytest

import pmfid
from pmfid import estimators
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.edges import EdgeFit
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.testing import checks_of
from pmfid.testing.contract import COMMON, OFF_LINE, ON_LINE
from tests.conftest import TRUTH, assert_near, cart_run

DT, CUTOFF = 0.01, 100 / 3
DRIVE = [cls for cls in ESTIMATORS.values() if not cls.refuses(pmfid.Drive(1.0).equation)]
BATCH = [cls for cls in DRIVE if issubclass(cls, BatchEstimator)]
RECURSIVE = [cls for cls in DRIVE if issubclass(cls, RecursiveEstimator)]
#: An estimator and its options: each recursive one in both precisions, with and without a memory.
CONFIGURATIONS = [(cls, {}) for cls in DRIVE] + [
    (cls, {"precision": "float32", "forgetting": 0.99}) for cls in RECURSIVE
]
CASES = [
    pytest.param(check, id=f"{cls.method}-{options.get('precision', 'float64')}-{name}")
    for cls, options in CONFIGURATIONS
    for name, check in checks_of(cls(pmfid.Drive(2.0), pmfid.Encoder(1e-5), DT, CUTOFF, **options))
]


@pytest.mark.parametrize("check", CASES)
def test_the_contract(check):
    check()


def test_the_contract_has_checks():
    assert len(COMMON) == 9
    assert len(OFF_LINE) == 3
    assert len(ON_LINE) == 10


def concrete() -> set[type[Estimator]]:
    """Return every class below `Estimator` with a method name, from any module of the package."""
    found = set()
    for module in pkgutil.iter_modules(estimators.__path__, "pmfid.estimators."):
        for _, cls in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if issubclass(cls, Estimator) and cls.__module__.startswith("pmfid") and cls.method:
                found.add(cls)
    return found


def test_no_estimator_hides():
    assert concrete() - {EdgeFit} == set(ESTIMATORS.values()), "EdgeFit alone takes a third signal"
    assert set(BATCH) | set(RECURSIVE) == set(DRIVE)
    assert set(estimators.METHODS) == {"auto", *ESTIMATORS}


@pytest.mark.parametrize("cls", DRIVE)
def test_finds_the_cart(cls, drive):
    run = cart_run(1, increments=1024)
    estimator = cls(drive, run.encoder, DT, CUTOFF)
    off_line = isinstance(estimator, BatchEstimator)
    theta = estimator.fit(run.u, run.counts).theta if off_line else estimator.run(run.u, run.counts).theta[-1]
    assert_near(theta, TRUTH, [0.005, 0.01, 0.05])
    assert estimator.names == ("mass", "viscous_friction", "coulomb_friction")


@pytest.mark.parametrize("cls", BATCH)
def test_batch_without_motion_says_so(cls, drive):
    with pytest.raises(pmfid.NotIdentifiableError, match="does not move"):
        cls(drive, pmfid.Encoder(1e-5), DT, CUTOFF).fit(np.ones(2000), np.zeros(2000, int))
