"""Estimators and estimates as objects: values, independent copies, separate states."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from tests.conftest import cart_run

DT, CUTOFF, SAMPLES = 0.01, 100 / 3, 1000
PRECISIONS = ("float64", "float32")
START = {"mass": 1.0, "viscous_friction": 10.0, "coulomb_friction": 1.0}
MODELS = {"drive": pmfid.Drive(2.0), "process": pmfid.TransferFunction(2, 1)}
COPIES = (copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)))
RUN = cart_run(1, samples=1300)
FIRST, LAST = (RUN.u[:SAMPLES], RUN.counts[:SAMPLES]), (RUN.u[SAMPLES:], RUN.counts[SAMPLES:])


def recursive(precision: str) -> list[RecursiveEstimator]:
    """Return every recursive estimator on every model that it takes."""
    return [
        ESTIMATORS[method](model, RUN.encoder, DT, CUTOFF, forgetting=0.995, precision=precision)
        for model in MODELS.values()
        for method in methods_for(model)
        if issubclass(ESTIMATORS[method], RecursiveEstimator)
    ]


def bits(estimator: RecursiveEstimator) -> bytes:
    """Return the output of the last samples and the state after them, as bytes."""
    track = estimator.run(*LAST)
    return track.theta.tobytes() + track.theta_std.tobytes() + track.status.tobytes() + estimator.get_state()


def test_a_process_pool_goes_on_with_the_bits_and_the_original_does_not_move() -> None:
    estimators = [estimator for precision in PRECISIONS for estimator in recursive(precision)]
    for estimator in estimators:
        estimator.run(*FIRST)
    before = [estimator.get_state() for estimator in estimators]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        elsewhere = list(pool.map(bits, estimators))
    assert [estimator.get_state() for estimator in estimators] == before
    assert elsewhere == [bits(estimator) for estimator in estimators]


@pytest.mark.parametrize("again", COPIES)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_copy_of_a_fleet_goes_on_with_the_bits_and_has_its_beginning(precision: str, again) -> None:
    first, last = (np.array([part, 2 * part]) for part in (FIRST[0], LAST[0]))
    counts, later = (np.array([part, part]) for part in (FIRST[1], LAST[1]))
    estimator = pmfid.BCRLS(MODELS["drive"], RUN.encoder, DT, CUTOFF, forgetting=0.995, precision=precision)
    estimator.run(*FIRST)
    fleet = pmfid.Fleet(estimator, 2)
    fleet.run(first, counts)
    estimator.run(*LAST)  # the beginning of the fleet is independent
    other = again(fleet)
    before = fleet.get_state()
    moved = other.run(last, later).theta
    assert fleet.get_state() == before
    assert np.array_equal(fleet.run(last, later).theta, moved)
    fleet.reset()
    other.reset()
    assert other.get_state() == fleet.get_state() != before


def test_a_configuration_is_a_value() -> None:
    initial, zeros = dict(START), [-1.0, -3.0]
    one = pmfid.RIV(MODELS["drive"], RUN.encoder, DT, CUTOFF, forgetting=0.99, initial=initial, prefilter_zeros=zeros)
    same = replace(one)
    initial["mass"], zeros[0] = 0.99, -2.0  # the caller's own objects
    assert one.initial == START
    assert one.prefilter_zeros == (-1.0, -3.0)
    assert one == same
    assert hash(one) == hash(same)
    assert one != replace(one, initial=START | {"mass": 0.995})
    assert len({one, same, replace(one, initial=None)}) == 2
    with pytest.raises(FrozenInstanceError):
        one.forgetting = 0.5
    with pytest.raises(TypeError):
        one.initial["mass"] = 0.5


def estimate_of(precision: str, drive: pmfid.Drive) -> pmfid.Estimate:
    run = cart_run(1, samples=1000)
    estimator = pmfid.RIV(drive, run.encoder, 0.01, 100 / 3, precision=precision)
    estimator.run(run.u, run.counts)
    return estimator.step(1.0, int(run.counts[-1]))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("again", COPIES)
def test_a_copy_has_the_same_bits(again, precision: str, drive: pmfid.Drive) -> None:
    one = estimate_of(precision, drive)
    other = again(one)
    for name in ("theta", "theta_std", "theta_cov"):
        assert np.array_equal(getattr(other, name), getattr(one, name))
    for name in ("innovation", "innovation_variance", "status"):
        assert getattr(other, name) == getattr(one, name)
    assert other["mass"] == one["mass"] > 0
