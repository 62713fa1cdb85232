"""The values in place of a wrong count cause no false reversal, no false stop and no additional count."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

import pmfid
from pmfid import RIV, RLS, Drive, Encoder, Status
from pmfid.pipeline.checks import check_record
from pmfid.simulation import CART, quantize, simulate_drive
from studies import glitch_sizes
from studies.glitches import AXES, STDS, SUSPICIOUS, effects, make
from studies.machines import Axis, machine_record
from studies.paper.truth import CartRecord
from tests.conftest import long_unless
from tests.test_diagnosis import axis_of, logged

WRONG = 54_321
#: A rotary axis: kg m2, N m s, N m, N m/V.
SMALL = {"mass": 2e-3, "viscous_friction": 0.02, "coulomb_friction": 0.05, "input_gain": 0.2}


def moving_record(axis: Axis, increments: int) -> CartRecord:
    return machine_record(axis, "nothing", "stop-and-go", increments, 50)


def position(estimator: RLS, u: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the sum of the motion in the filters (p,)."""
    return np.asarray(estimator.make_kernel().filter(u, counts)[0].sum(axis=0)[:2])


@pytest.mark.parametrize("apart", [1, 2, 3])
@pytest.mark.parametrize("name", ["cart", "spindle"])
def test_wrong_counts_close_to_each_other_are_flagged_alone_and_lose_nothing(name: str, apart: int) -> None:
    """The second wrong count was once predicted from a velocity with the whole error of the first."""
    axis = AXES[name]
    record = moving_record(axis, 4096)
    one = make("rls", axis, record.resolution)
    whole = position(one, record.u, record.counts)
    for place in range(2000, 2400, 23):
        counts = record.counts.copy()
        counts[[place, place + apart]] += (WRONG, -WRONG // 3)
        one.reset()
        flagged = np.flatnonzero(one.run(record.u, counts).has_status(SUSPICIOUS))
        assert flagged.tolist() == [place, place + apart]
        np.testing.assert_allclose(position(one, record.u, counts), whole, rtol=1e-6, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize("ratio", [1.6, 1.9, 3.0])
@pytest.mark.parametrize("name", ["rotary", "gantry"])
def test_two_wrong_counts_in_a_row_are_no_blow(name: str, ratio: float) -> None:
    """The second wrong count continues the first one, like a blow. Such a count once passed, and 1500 counts returned
    at once.
    """
    record = moving_record(AXES[name], 1024)
    one = make("rls", AXES[name], record.resolution)
    clean, whole = one.run(record.u, record.counts), position(one, record.u, record.counts)
    for place in range(1500, 2400, 83):
        counts = record.counts.copy()
        counts[[place, place + 1]] += (700, round(700 * ratio))
        one.reset()
        track = one.run(record.u, counts)
        assert np.flatnonzero(track.has_status(SUSPICIOUS)).tolist() == [place, place + 1]
        apart = np.abs(track.theta - clean.theta) / np.maximum(np.abs(clean.theta), STDS * clean.theta_std)
        assert np.max(apart[place:]) < 0.05
        np.testing.assert_allclose(position(one, record.u, counts), whole, rtol=1e-6, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize("method", ["bcrls", "rls"])
def test_a_wrong_count_as_the_axis_comes_to_rest_is_no_reversal(method: str) -> None:
    """The prediction continues the motion, and the correction goes back. The direction at rest was once wrong."""
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
    assert track.has_status(Status.COUNT_JUMP)[jumps].all()
    assert track.theta[-1, 0] == pytest.approx(SMALL["mass"], rel=0.01)


@pytest.mark.parametrize("axis", ["spindle", "stage"])
def test_one_wrong_count_of_a_hundred(axis: str) -> None:
    found = [one for _, one in effects(axis, "1 % glitches", 3, seed=11)]
    assert sum(one.missed for one in found) == 0
    assert np.quantile([one.largest for one in found], 0.9) < 0.06
    assert max(one.after for one in found) < 0.05


@pytest.mark.parametrize("kind", glitch_sizes.KINDS)
@pytest.mark.parametrize("largest", [30, 1000, 5000])
@pytest.mark.parametrize("method", glitch_sizes.METHODS)
def test_wrong_counts_of_like_sizes_do_not_widen_the_limit(method: str, largest: int, kind: str) -> None:
    """Each accepted wrong count once allowed a larger one, with errors of 82 to 89 % without a flag."""
    for seed, precision in ((3, "float64"), (6, "float32")):  # encoders of 4096 and 1024 increments
        case = glitch_sizes.case_of("cart", method, seed, precision)
        assert case is not None
        found = glitch_sizes.harm_of(case, kind, 0.01, largest, seed)
        assert found.silent < glitch_sizes.FAR
        assert found.after < glitch_sizes.FORGOTTEN


@pytest.mark.parametrize("seed", [1, 7])
@pytest.mark.parametrize("method", glitch_sizes.METHODS)
def test_wrong_counts_from_the_start_do_not_keep_it_learning(method: str, seed: int) -> None:
    """Each found wrong count once restarted the learning. With 3 % of wrong counts, the learning never ended."""
    case = glitch_sizes.case_of("cart", method, seed, start=True)
    assert case is not None
    for kind in ("uniform", "log-uniform"):
        assert glitch_sizes.harm_of(case, kind, 0.03, 1000, seed).silent < glitch_sizes.FAR


def wrong_record(axis: str, seed: int, largest: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return clusters of wrong counts, and 60 samples that are all wrong."""
    case = glitch_sizes.case_of(axis, "riv", seed)
    assert case is not None
    rng = np.random.default_rng([seed, largest])
    places = glitch_sizes.wrong_places("clustered", 0.03, case, rng)
    counts = case.record.counts[:2500].copy()
    places = places[places < 2200]
    counts[places] += glitch_sizes.wrong_sizes("uniform", largest, places.size, rng)
    counts[2250:2310] += rng.integers(-largest, largest + 1, 60)
    return case.record.u[:2500], counts


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cls", [RLS, RIV])
def test_clusters_of_wrong_counts_have_the_same_bits_side_by_side(cls: type[RLS], precision: str) -> None:
    records = [wrong_record("cart", seed, largest) for seed in (0, 3, 9) for largest in (5, 20, 300, 10**6)]
    one = cls(Drive(2.0), Encoder(2e-5), 0.01, 50.0, forgetting=0.995, precision=precision)
    tracks = pmfid.Fleet(one, 12, workers=1).run(
        np.stack([u for u, _ in records]), np.stack([counts for _, counts in records]), every=1
    )
    for axis, (u, counts) in enumerate(records):
        one.reset()
        alone = one.run(u, counts)
        assert np.array_equal(tracks.theta[axis], alone.theta)
        assert np.array_equal(tracks.status[axis], alone.status)


@pytest.mark.parametrize("largest", [300, 10**6])
def test_after_nothing_but_wrong_counts_it_goes_on(largest: int) -> None:
    u, counts = wrong_record("cart", 3, largest)
    case = glitch_sizes.case_of("cart", "rls", 3)
    assert case is not None
    case.estimator.reset()
    track = case.estimator.run(u, counts)
    bad = track.has_status(Status.COUNT_JUMP | Status.SETTLING)
    assert bad[2253:2310].mean() > 0.9
    assert not bad[2370:].any()
    assert track.theta[-1, 0] == pytest.approx(CART.mass, rel=0.05)


def test_wrong_readings_are_no_velocity() -> None:
    record = logged("damped", "none")
    counts, rng = record.counts.copy(), np.random.default_rng(5)
    places = np.flatnonzero(rng.random(counts.size) < 0.01)
    counts[places] += rng.choice([-1, 1], places.size) * rng.integers(100_000, 10_000_000, places.size)
    axis = axis_of()
    axis = axis.model_copy(update={"encoder": axis.encoder.model_copy(update={"guard": False})})
    (finding, *_) = check_record(replace(record, counts=counts), axis)
    assert finding.text.startswith("the counts jump by")


@pytest.mark.parametrize(
    ("method", "largest", "kind", "precision"),
    long_unless(
        lambda method, largest, kind, precision: (precision == "float32") == (largest == 1000),
        product(glitch_sizes.METHODS, [100, 1000, 100_000], glitch_sizes.KINDS, ["float64", "float32"]),
    ),
)
def test_what_wrong_counts_taught_is_put_right_before_it_counts(
    method: str, largest: int, kind: str, precision: str
) -> None:
    """While the guard learns, it accepts nearly all counts. The limit once stayed wide, and a mass 28 times too large
    had no flag.
    """
    for axis, seed in product(("heavy", "spindle", "stage"), (1, 2)):
        case = glitch_sizes.case_of(axis, method, seed, precision, start=True)
        if case is not None:
            found = glitch_sizes.harm_of(case, kind, 0.03, largest, seed)
            assert found.silent < 0.1
            assert found.after < 0.02


@pytest.mark.parametrize("method", glitch_sizes.METHODS)
@pytest.mark.parametrize("axis", AXES)
def test_no_healthy_estimator_begins_again(axis: str, method: str) -> None:
    for seed in range(6):
        case = glitch_sizes.case_of(axis, method, seed)
        if case is not None:
            begins = case.clean.has_status(Status.STARTING).astype(int)
            assert np.sum(np.diff(begins) == 1) == 0
