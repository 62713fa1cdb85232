"""Unseen inputs: the values that replace them under a controller, and at a switch of the input."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid import Drive, Encoder
from pmfid._stage import Inputs
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import RLS
from pmfid.monitor.monitor import GuessedSamples, guess, longest
from pmfid.records.gaps import bridge_input, hold_input
from pmfid.simulation import DriveParameters, prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats
from tests.refusals import refused

DT, STEP, CUTOFF = 0.004, 2e-5, 20.0
RATE = CUTOFF * DT
STAGE = DriveParameters(6.3, 9.0, 2.6, 3.34)
TRUTH = np.array([STAGE.mass, STAGE.viscous_friction, STAGE.coulomb_friction])
SETTINGS = {"model": Drive(STAGE.input_gain), "dt": DT, "encoder": Encoder(STEP), "cutoff": CUTOFF}


def kept(samples: int, part: float, burst: int = 1, seed: int = 1) -> Flags:
    rng, there = np.random.default_rng(seed), np.ones(samples, bool)
    for first in rng.integers(50, samples - 100, round(part * samples / burst)):
        there[first : first + burst] = False
    return there


def wave(samples: int = 6000) -> Floats:
    return np.sin(0.1 * np.arange(samples)) + 0.5 * np.sin(0.037 * np.arange(samples))


def waving(samples: int = 6000) -> Floats:
    """Return an input like that of a controller with a coarse encoder: smooth, with added noise."""
    return wave(samples) + 0.003 * np.random.default_rng(2).standard_normal(samples)


def held(samples: int, seed: int = 0) -> tuple[Floats, Counts]:
    rng = np.random.default_rng(seed)
    u = prbs(samples, clock=25, amplitude=4.0, rng=rng)
    return u, quantize(simulate_drive(STAGE, u, DT).x, STEP, STEP * rng.random())


# --- off-line ---------------------------------------------------------------------------------------------------------


def test_a_held_input_is_known_between_equal_values_and_no_other_is() -> None:
    u, lost = np.repeat([1.0, -1.0, 2.0, -1.0], 25), np.nan
    u[[0, 30, 50, 60, 61]] = lost
    found = hold_input(u)
    assert np.flatnonzero(np.isnan(found)).tolist() == [0, 50]  # before the record, and at a switch
    assert found[[30, 60, 61]].tolist() == [-1.0, 2.0, 2.0]
    smooth = np.where(np.arange(100) == 40, lost, waving(100))
    assert bridge_input(smooth)[40] == pytest.approx(np.mean(smooth[[39, 41]]))


def test_an_input_that_rests_now_and_then_is_not_held() -> None:
    u = waving(3000)
    u[1000:2800], u[1500], u[[400, 2801]] = 0.0, np.nan, np.nan
    assert np.flatnonzero(np.isnan(hold_input(u))).tolist() == [400, 1500, 2801]


# --- on-line ----------------------------------------------------------------------------------------------------------


def online(there: Flags, u: Floats, counts: Counts) -> tuple[Floats, np.ndarray]:
    """Return theta (m, 3) and status (m,) at the present samples."""
    riv, found, last = RIV(**SETTINGS), [], -1
    inputs = Inputs()
    for k in np.flatnonzero(there).tolist():
        between = guess(inputs, RATE, k - last - 1, float(u[k]), int(counts[k])) if k - last > 1 else None
        if between and between.doubt:
            riv.doubt(between.doubt)
        for moment in (*(between.samples if between else ()), (float(u[k]), int(counts[k]))):
            estimate = riv.step(*moment)
            inputs.step(*moment)
        found.append((estimate.theta / TRUTH, estimate.status))
        last = k
    return np.array([theta for theta, _ in found]), np.array([status for _, status in found])


@pytest.mark.parametrize(("part", "used"), [(0.1, 0.7), (0.3, 0.4)])
def test_on_line_a_hidden_switch_costs_some_samples_and_no_spike(part: float, used: float) -> None:
    """Filters that restart lost half of the samples at 10 %, and all but a tenth at 30 %."""
    u, counts = held(4000)
    theta, status = online(kept(4000, part), u, counts)
    settled, own = (status & int(Status.SETTLING)) == 0, (status & int(Status.FALLBACK | Status.STARTING)) == 0
    assert np.mean(settled) > used
    assert np.mean(own) > used
    late = np.arange(own.size) > round(1 / DT)
    assert np.all((theta[own & late] > 0.7) & (theta[own & late] < 1.5))
    np.testing.assert_allclose(theta[-1], 1.0, atol=0.05)


@pytest.mark.parametrize("missing", [1, 4])
def test_where_a_held_input_switched_nothing_is_learnt_for_a_while(missing: int) -> None:
    riv = RIV(**SETTINGS)
    inputs = Inputs()
    for k in range(1000):
        inputs.step(4.0 * (-1) ** (k // 12), k)
    last = 4.0 * (-1) ** (999 // 12)
    still, switched = (guess(inputs, RATE, missing, u, 1000 + missing) for u in (last, -last))
    assert still is not None
    assert switched is not None
    assert still.doubt == 0
    assert 4 / (CUTOFF * DT) < switched.doubt < riv.settle_samples
    assert still.samples == tuple((last, 1000 + k) for k in range(missing))


def test_a_gap_that_is_short_for_the_filters_is_stepped_through_however_many_samples_it_has() -> None:
    """At 4 kHz the filters once never settled between bursts of 12 ms, and the fallback gave wild estimates."""
    assert (longest(CUTOFF / 4000), longest(RATE)) == (50, 8)
    fast = Inputs()
    for k in range(300):
        fast.step(1.0, (k * k) // 200)
    found = guess(fast, CUTOFF / 4000, 50, 1.0, 350 * 350 // 200)
    assert isinstance(found, GuessedSamples)
    assert found.doubt == 0
    true = np.arange(300, 350) ** 2 // 200
    assert np.max(np.abs(np.array([counts for _, counts in found.samples]) - true)) <= 1


def test_a_doubt_leaves_out_samples_and_the_filters_go_on() -> None:
    u, counts = held(2000)
    doubted, plain = RLS(**SETTINGS), RLS(**SETTINGS)
    for method in (doubted, plain):
        method.run(u[:1000], counts[:1000])
    doubted.doubt(20)
    track, other = (method.run(u[1000:], counts[1000:]) for method in (doubted, plain))
    settling = np.flatnonzero(track.has_status(Status.SETTLING))
    assert settling.tolist() == list(range(settling.size))
    assert 19 <= settling.size <= 27
    assert not np.any(other.has_status(Status.SETTLING))
    assert np.ptp(track.theta[:19], axis=0).max() == 0.0
    np.testing.assert_allclose(track.theta[-1], other.theta[-1], rtol=0.01)
    doubted.doubt(10**6)
    doubted.set_state(doubted.get_state())  # the state is valid
    refused(*(("whole number", lambda wrong=wrong: doubted.doubt(wrong)) for wrong in (-1, 1.5, True)))
