"""What stands in place of a wrong count: no reversal, no stop that was not one, and no count too many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pmfid import RIV, RLS, Drive, Encoder, Status
from pmfid.paper.truth import CartRecord
from pmfid.session.checks import checked
from pmfid.simulation import CART, quantize, simulate_drive
from studies.glitches import AXES, STDS, SUSPICIOUS, effects, make
from studies.machines import Axis, machine_record
from tests.test_diagnosis import axis_of, logged

WRONG = 54_321
#: A rotary axis: kg m2, N m s, N m, N m/V.
SMALL = {"mass": 2e-3, "viscous_friction": 0.02, "coulomb_friction": 0.05, "input_gain": 0.2}


def moving_record(axis: Axis, increments: int) -> CartRecord:
    return machine_record(axis, "nothing", "stop-and-go", increments, 50)


def position(estimator: RLS, u: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """What the filters had of the motion (p,), summed up."""
    return np.asarray(estimator.make_kernel().filter(u, counts)[0].sum(axis=0)[:2])


@pytest.mark.parametrize("apart", [1, 2, 3])
@pytest.mark.parametrize("name", ["cart", "spindle"])
def test_wrong_counts_close_to_each_other_are_flagged_alone_and_lose_nothing(name: str, apart: int) -> None:
    """The second one was predicted from a velocity that had the whole error of the first in one sample."""
    axis = AXES[name]
    record = moving_record(axis, 4096)
    one = make("rls", axis, record.resolution)
    whole = position(one, record.u, record.counts)
    for place in range(2000, 2400, 23):
        counts = record.counts.copy()
        counts[[place, place + apart]] += (WRONG, -WRONG // 3)
        one.reset()
        flagged = np.flatnonzero(one.run(record.u, counts).flagged(SUSPICIOUS))
        assert flagged.tolist() == [place, place + apart]
        np.testing.assert_allclose(position(one, record.u, counts), whole, rtol=1e-6, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize("ratio", [1.6, 1.9, 3.0])
@pytest.mark.parametrize("name", ["rotary", "gantry"])
def test_two_wrong_counts_in_a_row_are_no_blow(name: str, ratio: float) -> None:
    """The second one goes on from the first as a blow does: it was let in, and 1500 counts came back at once."""
    record = moving_record(AXES[name], 1024)
    one = make("rls", AXES[name], record.resolution)
    clean, whole = one.run(record.u, record.counts), position(one, record.u, record.counts)
    for place in range(1500, 2400, 83):
        counts = record.counts.copy()
        counts[[place, place + 1]] += (700, round(700 * ratio))
        one.reset()
        track = one.run(record.u, counts)
        assert np.flatnonzero(track.flagged(SUSPICIOUS)).tolist() == [place, place + 1]
        apart = np.abs(track.theta - clean.theta) / np.maximum(np.abs(clean.theta), STDS * clean.theta_std)
        assert np.max(apart[place:]) < 0.05
        np.testing.assert_allclose(position(one, record.u, counts), whole, rtol=1e-6, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize("method", ["bcrls", "rls"])
def test_a_wrong_count_as_the_axis_comes_to_rest_is_no_reversal(method: str) -> None:
    """What is foreseen goes on, so what puts it right goes back: the direction at rest was the wrong one."""
    axis = AXES["gantry"]
    record = moving_record(axis, 4096)
    one = make(method, axis, record.resolution)
    clean = one.run(record.u, record.counts)
    rests = np.diff(record.counts, prepend=record.counts[0]) == 0
    last = [k for k in range(2001, 5000) if np.all(rests[k : k + 8]) and not rests[k - 1]]
    assert len(last) >= 4
    for place in (place for k in last[:4] for place in (k - 1, k, k + 1)):
        counts = record.counts.copy()
        counts[place] += WRONG
        one.reset()
        track = one.run(record.u, counts)
        scale = np.maximum(np.abs(clean.theta), STDS * np.maximum(clean.theta_std, track.theta_std))
        assert np.max(np.abs(track.theta - clean.theta)[place:] / scale[place:]) < 0.05


@pytest.mark.parametrize("jump", [True, False])
@pytest.mark.parametrize("place", [5, 12, 40])
def test_a_wrong_count_while_the_filters_settle_for_the_first_time_hides_no_later_ones(place: int, jump: bool) -> None:
    t = np.arange(4000) * 0.005
    u = 1.2 * np.sin(1.4 * t) + 0.8 * np.sin(3.8 * t + 1.0) + 0.5 * np.sin(8.2 * t + 2.0)
    resolution = 2 * np.pi / 4096
    counts = quantize(simulate_drive(replace(CART, **SMALL), u, 0.005).x, resolution)
    counts[place : None if jump else place + 1] += 100_000
    jumps = np.arange(1000, 4000, 200)
    counts += 20_000 * np.searchsorted(jumps, np.arange(4000), side="right")
    track = RIV(Drive(SMALL["input_gain"]), Encoder(resolution), 0.005, 50.0, forgetting=0.998).run(u, counts)
    assert track.flagged(Status.COUNT_JUMP)[jumps].all()
    assert track.theta[-1, 0] == pytest.approx(SMALL["mass"], rel=0.01)


@pytest.mark.parametrize("axis", ["spindle", "stage"])
def test_one_wrong_count_of_a_hundred(axis: str) -> None:
    found = [one for _, one in effects(axis, "1 % glitches", 3, seed=11)]
    assert sum(one.missed for one in found) == 0
    assert np.quantile([one.largest for one in found], 0.9) < 0.06
    assert max(one.after for one in found) < 0.05


def test_wrong_readings_are_no_velocity() -> None:
    record = logged("damped", "none")
    counts, rng = record.counts.copy(), np.random.default_rng(5)
    places = np.flatnonzero(rng.random(counts.size) < 0.01)
    counts[places] += rng.choice([-1, 1], places.size) * rng.integers(100_000, 10_000_000, places.size)
    axis = axis_of()
    axis = axis.model_copy(update={"encoder": axis.encoder.model_copy(update={"guard": False})})
    (finding, *_) = checked(replace(record, counts=counts), axis)
    assert finding.text.startswith("the counts jump by")
