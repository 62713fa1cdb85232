"""The estimate after a sample: one class in both precisions, and a value that can be copied and sent."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import pmfid
from tests.conftest import cart_run
from tests.refusals import refused

PRECISIONS = ("float64", "float32")


def estimate_of(precision: str, drive: pmfid.Drive) -> pmfid.Estimate:
    run = cart_run(1, samples=1000)
    estimator = pmfid.RIV(drive, run.encoder, 0.01, 100 / 3, precision=precision)
    estimator.run(run.u, run.counts)
    return estimator.step(1.0, int(run.counts[-1]))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_has_the_same_bits(again, precision: str, drive: pmfid.Drive) -> None:
    one = estimate_of(precision, drive)
    other = again(one)
    for name in ("theta", "theta_std", "theta_cov"):
        assert np.array_equal(getattr(other, name), getattr(one, name))
    for name in ("innovation", "innovation_variance", "status"):
        assert getattr(other, name) == getattr(one, name)
    assert other["mass"] == one["mass"] > 0


def test_an_estimate_is_not_made_by_hand_or_of_parts_that_do_not_fit(drive: pmfid.Drive) -> None:
    made, parts = estimate_of("float64", drive).__reduce__()
    places = ((1, np.ones(9)), (2, np.ones(8)), (3, np.ones(2)), (4, np.ones(4)))
    refused(("what the step of a recursive estimator returns", pmfid.Estimate), kind=TypeError)
    refused(
        *(("not the parts of an estimate", lambda k=k, x=x: made(*parts[:k], x, *parts[k + 1 :])) for k, x in places),
        kind=ValueError,
    )
