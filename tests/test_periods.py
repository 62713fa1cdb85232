"""Transfer functions of a periodic input, or of an input with the wrong hold: the noise is recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.linear.residuals import period_of
from pmfid.simulation.process import simulate_process
from studies.process_confidence import estimator_of, identified
from studies.process_records import INPUTS, LENGTHS, NOISES, RandomPlant, make_noise, open_record, random_plant

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


@pytest.mark.parametrize(("n", "m"), [(2, 0), (3, 1)])
@pytest.mark.long
def test_the_error_of_a_model_does_not_average_out(n, m):
    """With four times the periods the bars were once half as long, while the estimate was as wrong."""
    bars, errors = [], []
    for periods in (3, 12):
        found = [identified(estimator(n, m), repeated(seed, periods)) for seed in range(1)]
        assert all("unmodelled" in status for *_, status in found)
        bars.append(np.median([process.gain_std for process, *_ in found]))
        errors.append(np.median([abs(process.gain - 1.0) for process, *_ in found]))
    assert bars[1] / bars[0] > 0.75
    assert errors[1] / errors[0] > 0.75


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


def test_a_pole_that_may_be_anywhere_is_not_known():
    """A pole far beyond the samples reaches its bound within two standard deviations.

    A limit of one half was never reached, and the error bars of the other poles were 295 times too short. On some
    processors the search ends at an unstable pole, which is unknown as well.
    """
    plant, record = swept("AR(1) 0.9")
    process, _, status = identified(estimator_of(plant), other(record))
    assert np.max(np.abs(process.poles)) * plant.dt > 20 or np.max(process.poles.real) > 0
    assert "uncertain" in status


@pytest.mark.parametrize("seed", [3, 9])
def test_sines_that_hide_the_hold_say_so(seed: int) -> None:
    """Slow sines are the same for either hold, but the poles are not: 13.6 and 21.9 bars off, with an empty status."""
    rng = np.random.default_rng([seed, INPUTS.index("multisine"), NOISES.index("white")])
    plant, hold = random_plant(rng), ("zoh", "foh")[int(rng.integers(2))]
    record = open_record(plant, "multisine", "white", LENGTHS[seed % len(LENGTHS)], hold, rng)
    process, _, status = identified(estimator_of(plant), other(record))
    assert status == ("model_spread",)
    mine, true = linear_sum_assignment(np.abs(np.log(process.poles[:, None] / plant.poles)))
    z = (process.poles[mine] - plant.poles[true]).real / process.poles_std[mine, 0]
    assert np.max(np.abs(z)) > 10
