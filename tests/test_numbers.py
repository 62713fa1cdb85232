"""Singular equations, diverged tracks and diverged simulations are refused without a warning."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import pmfid
from pmfid.config.axis import Axis
from pmfid.encoder import quantize
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.batch import check_identifiable
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.results import Columns
from pmfid.pipeline.identify import identify
from pmfid.records.record import Record
from pmfid.simulation import make_scenario
from tests.refusals import refused


def axis_of(method: str = "auto", resolution: float = 0.01, **more: dict[str, object]) -> Axis:
    sections = {
        "record": {"input": "u", "output": "y", "dt": 0.01},
        "encoder": {"resolution": resolution},
        "model": {"input_gain": 2.0},
        "estimator": {"cutoff": 50.0, "method": method},
    }
    return Axis.model_validate({name: section | more.get(name, {}) for name, section in sections.items()})


def test_equations_without_one_solution_are_refused() -> None:
    without = (np.zeros((2, 2)), np.ones((2, 2)), np.full((2, 2), np.nan), 1e-320 * np.eye(2))
    huge = Columns(np.full((50, 2), 1e200), np.ones(50), np.ones((50, 2)), np.ones(50, bool), 0)
    refused(
        *(("no unique solution", partial(inverse_of, matrix)) for matrix in without),
        ("exceeds the range of numbers", lambda: check_identifiable(huge, ("mass", "drag"))),
        kind=NotIdentifiableError,
    )
    np.testing.assert_array_equal(inverse_of(2 * np.eye(2)), np.eye(2) / 2)


def test_a_counter_of_one_bit_is_refused() -> None:
    """The position only falls, so that the instruments depend linearly on each other."""
    counts = -np.cumsum(np.ones(300, np.int64))
    record = Record(np.sin(np.arange(300.0)), counts, 0.01, 1e-4, (), "one bit")
    with pytest.raises(NotIdentifiableError):
        identify(record, axis_of(resolution=1e-4))


def test_prefilter_zeros_are_no_parameters_of_a_method_that_simulates() -> None:
    run = make_scenario("prbs", seed=1, duration=10.0)
    counts = quantize(run.motion.x, 1e-4)
    plain = pmfid.IV(pmfid.Drive(2.0), pmfid.Encoder(1e-4), 0.01, 50.0)
    given = replace(plain, prefilter_zeros=(-5.0, -4.0))
    assert given.names == plain.names
    np.testing.assert_allclose(given.fit(run.motion.u, counts).theta, plain.fit(run.motion.u, counts).theta, rtol=1e-4)
