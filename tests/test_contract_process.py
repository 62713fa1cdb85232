"""The contract of estimators on a linear process: every estimator that takes one is found and checked."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid import Status, TransferFunction
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.testing import checks_of
from tests.test_transfer_function import UNDERSHOOT, build, make_record

METHODS = [ESTIMATORS[name] for name in methods_for(UNDERSHOOT.model)]
RECURSIVE = [cls for cls in METHODS if issubclass(cls, RecursiveEstimator)]
NAMES = ("a0", "a1", "b0", "b1")


#: An estimator and its options: each recursive one in both precisions, with and without a memory.
CONFIGURATIONS = [(cls, {}) for cls in METHODS] + [
    (cls, {"precision": "float32", "forgetting": 0.998}) for cls in RECURSIVE
]
CASES = [
    pytest.param(check, id=f"{cls.method}-{options.get('precision', 'float64')}-{name}")
    for cls, options in CONFIGURATIONS
    for name, check in checks_of(cls(UNDERSHOOT.model, pmfid.Encoder(1e-3), 0.1, 2.0, **options))
]


@pytest.mark.parametrize("check", CASES)
def test_the_contract(check):
    check()


def test_the_methods_are_these():
    found = {cls.method for cls in METHODS}
    assert {"ls", "bcls", "srivc", "rls", "bcrls"} <= found
    assert "riv" not in found


@pytest.mark.parametrize("cls", METHODS)
def test_finds_the_truth_after_noise(cls):
    """The process has a zero in the right half-plane, and 30 dB of noise that is not the encoder's."""
    run = make_record(UNDERSHOOT, 1, snr=30.0)
    estimator = build(cls, UNDERSHOOT, run)
    off_line = isinstance(estimator, BatchEstimator)
    theta = estimator.fit(run.u, run.counts).theta if off_line else estimator.run(run.u, run.counts).theta[-1]
    np.testing.assert_allclose(theta, UNDERSHOOT.truth, rtol=0.02)
    assert estimator.names == NAMES


@pytest.mark.parametrize("cls", RECURSIVE)
def test_rest_means_nothing_to_a_process(cls):
    track = cls(UNDERSHOOT.model, pmfid.Encoder(1e-3), 0.1, 2.0, forgetting=0.98).run(
        np.zeros(2000), np.zeros(2000, int)
    )
    assert not np.any(track.has_status(Status.STANDSTILL))


@pytest.mark.parametrize("cls", RECURSIVE)
def test_the_largest_model_of_the_kernel(cls):
    """The model has eight parameters: fourth order with three zeros."""
    estimator = cls(TransferFunction(4, 3), pmfid.Encoder(1e-6), 0.01, 20.0)
    assert len(estimator.step(1.0, 0).theta) == 8
    with pytest.raises(pmfid.UsageError, match="at most 8 parameters, but this transfer_function has 9: a0"):
        cls(TransferFunction(5, 3), pmfid.Encoder(1e-6), 0.01, 20.0)
