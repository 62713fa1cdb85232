"""Transfer functions of a periodic input, or of an input with the wrong hold: the noise is recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.linear.residuals import period_of
from pmfid.simulation.process import simulate_process
from studies.process_records import (
    INPUTS,
    NOISES,
    RandomPlant,
    estimator_of,
    identified,
    make_noise,
    open_record,
    random_plant,
)

DT, PERIOD = 0.1, 150
#: Two resonances, of 2 and 5.5 rad/s.
A, B = np.polymul([1.0, 0.8, 4.0], [1.0, 1.2, 30.0]), (20.0, 120.0)
TRUTH = np.r_[A[:0:-1], B[::-1]]


def repeated(seed: int, periods: int = 10, noise: str = "resonance", *, settled: bool = True) -> Experiment:
    """Simulate sines of random phase, in the steady state or from rest, with noise at 25 dB."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, 20)
    one = np.cos(2 * np.pi / PERIOD * np.outer(np.arange(PERIOD), np.arange(1, 21)) + phases).sum(axis=1) / 4
    u = np.tile(one, periods + 4)
    y, first = simulate_process(B, A, u, DT), 4 * PERIOD * settled
    u, y = u[first:][: periods * PERIOD], y[first:][: periods * PERIOD]
    return Experiment(u, y + np.std(y) * 10 ** (-25 / 20) * make_noise(noise, y.size, rng), dt=DT)


def estimator(n: int, m: int) -> SRIVC:
    return SRIVC(TransferFunction(n, m), Encoder(1.0), DT, 4.0)


def test_a_period_is_found_where_there_is_one():
    rng = np.random.default_rng(1)
    assert period_of(repeated(0).u) == PERIOD
    assert period_of(np.tile(np.repeat([1.0, -1.0], [30, 10]), 5)[7:]) == 40
    assert period_of(rng.choice([-1.0, 1.0], 500).repeat(4)) is None
    assert period_of(np.repeat([0.0, 1.0], 100)) is None
    assert period_of(np.ones(100)) is None


@pytest.mark.parametrize(("noise", "settled"), [("resonance", True), ("AR(1) 0.9", False)])
@pytest.mark.long
def test_the_right_model_of_ten_periods_is_right(noise, settled):
    """The estimate is right also outside the steady state: no leakage between periods occurs, unlike in single
    transforms.
    """
    z, alarms = [], 0
    for seed in range(3):
        process, theta, status = identified(estimator(4, 1), repeated(seed, noise=noise, settled=settled))
        alarms += status != ()
        z.append((theta - TRUTH) / np.sqrt(np.diagonal(process.cov)))
    assert alarms == 0
    assert 0.85 <= np.mean(np.abs(z) < 1.96) <= 1.0


def swept(noise: str) -> tuple[RandomPlant, Experiment]:
    """Return 300 samples of a sweep, as in the study, with the hold that made it."""
    rng = np.random.default_rng([0, INPUTS.index("sweep"), NOISES.index(noise)])
    plant, hold = random_plant(rng), ("zoh", "foh")[int(rng.integers(2))]
    return plant, open_record(plant, "sweep", noise, 300, hold, rng)


def other(record: Experiment) -> Experiment:
    return replace(record, hold={"zoh": "foh", "foh": "zoh"}[record.hold])


def test_the_other_hold_is_tried():
    """The residual did not show the input: wrong gain and pole, 3.7 and 2.4 bars off, compensated for the hold."""
    plant, record = swept("resonance")
    assert identified(estimator_of(plant), record)[2] == ()
    assert identified(estimator_of(plant), other(record))[2] == ("unmodelled",)
