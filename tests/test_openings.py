"""Opening the memory of one parameter leaves finite variances and estimates that recover."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from tests.conftest import cart_run
from tests.hostile.openings import faults_of
from tests.hostile.states import estimators
from tests.test_many import fleet_record, make

CART = {"mass": 1.07, "viscous_friction": 12.8, "coulomb_friction": 0.8}


@pytest.mark.parametrize(("name", "estimator"), list(estimators())[::2])
def test_openings_of_every_kind_leave_numbers(name: str, estimator: RecursiveEstimator) -> None:
    assert faults_of(estimator, np.random.default_rng(len(name)), 12) == []


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("cls", [pmfid.RLS, pmfid.BCRLS, pmfid.RIV])
@pytest.mark.parametrize("parameter", list(CART))
def test_an_opened_estimate_comes_back(cls: type[RecursiveEstimator], precision: str, parameter: str) -> None:
    run = cart_run(4, samples=3000, increments=4096)
    estimator = cls(pmfid.Drive(2.0), run.encoder, 0.01, 30.0, forgetting=0.998, precision=precision)
    for start in range(0, 3000, 500):
        part = slice(start, start + 500)
        before = estimator.run(run.u[part], run.counts[part])
        if start:
            assert np.all(np.abs(before.theta[100:] / list(CART.values()) - 1) < 0.1)
            assert np.mean(before.status[200:] == 0) > 0.9
        estimator.open_memory(1e-5, parameter)


def test_opening_moves_no_estimate() -> None:
    """The estimate also stays when the right-hand side is in force."""
    estimator = make(pmfid.RLS, forgetting=0.99)
    u, counts = fleet_record()
    estimator.run(u[0, :300], counts[0, :300])
    theta = estimator.estimate.theta
    twin = make(pmfid.RLS, forgetting=0.99)
    twin.set_state(estimator.get_state())
    estimator.open_memory(0.5, "viscous_friction")
    moved, usual = (np.abs(one.run(u[0, 300:303], counts[0, 300:303]).theta[-1] - theta) for one in (estimator, twin))
    assert np.all(moved < 10 * usual + 1e-3 * np.abs(theta))
