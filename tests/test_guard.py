"""Counts that no motion explains are flagged and kept out; all other samples stay unchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pmfid
from pmfid import BCRLS, IV, LS, RIV, RLS, Drive, Encoder, Status
from pmfid._stage import find_outliers
from pmfid.monitor.calibration import Calibration
from pmfid.monitor.events import Alarm, Outlier, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import CART, CART_DT, Schedule, make_scenario, prbs, quantize, resolution_of, simulate_drive
from pmfid.simulation.scenarios import SCENARIOS
from studies.glitches import FAR, FORGOTTEN, MACHINES, Case, clean_records, harm, make, run, wrong_places, wrong_sizes
from studies.machines import AXES, machine_record
from studies.monitoring.axis import changing, make_riv
from tests.conftest import TRUTH, cart_run, long_unless
from tests.firmware.build import GCC, M4F, Target
from tests.firmware.replay import difference, exported
from tests.test_many import WAYS

DELAY = 8


def case_of(axis: str, motion: str, increments: int, method: str = "rls", precision: Any = "float64") -> Case:
    """Return a clean case of the study."""
    for name, lines, u, counts, resolution in clean_records(axis, 0):
        if (name, lines) == (motion, increments):
            case = Case(axis, motion, lines, u, counts, make(method, axis, resolution, precision), np.empty(0))
            return replace(case, mass=run(case, counts)[0])
    raise AssertionError(motion)


@pytest.mark.parametrize("hold", [25, 50, 100])
@pytest.mark.parametrize("method", ["rls", "bcrls", "riv"])
def test_an_early_wrong_count_teaches_the_guard_nothing(method: str, hold: int) -> None:
    """One wrong count of 20 to 300 in the first 600 samples once locked the guard: the mass was 40 to 97 % wrong for up
    to 36 memories, without a flag.
    """
    case = case_of("cart", f"square, {hold}", 4096, method)
    for place, size in zip(range(3, 600, 83), (20, -60, 300, -20, 60, -300, 20, 60), strict=True):
        counts = case.counts.copy()
        counts[place] += size
        mass, _, wrong = run(case, counts)
        apart = np.abs(mass - case.mass) / MACHINES["cart"].drive.mass
        assert np.max(apart[800:]) < 0.005
        assert set(np.flatnonzero(wrong)) <= {place}


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("kind", ["uniform", "log-uniform", "constant", "bit flips"])
@pytest.mark.parametrize("largest", [60, 300, 100_000])
def test_one_wrong_count_of_a_hundred_is_forgotten_in_two_memories(largest: int, kind: str, precision: str) -> None:
    """Counts that were 1 % wrong by 60 or 300 once made the mass 45 % wrong for 43 memories."""
    rng = np.random.default_rng(largest)
    for axis, motion in (("stage", "prbs"), ("gantry", "square, 25")):
        case = case_of(axis, motion, 4096, precision=precision)
        places = wrong_places(kind, 0.01, rng)
        found = harm(case, places, wrong_sizes(kind, largest, places.size, rng))
        assert found.silent < FAR
        assert found.after < FORGOTTEN
        assert not found.late


@pytest.mark.parametrize("size", [100, -5000, 550_523])
def test_every_single_wrong_count_is_found(size: int) -> None:
    """Before a change of the acceleration, a wrong count was once taken for a shift of the zero."""
    late, early = case_of("cart", "prbs, 3", 256), case_of("spindle", "square, 25", 4096)
    for place, (case, before) in product(range(0, 2500, 3), ((late, 30), (early, 4))):
        counts = case.counts.copy()
        counts[place] += size
        window = slice(max(0, place - before), place + 30)
        wrong = find_outliers(counts[window], np.arange(counts[window].size, dtype=float), 1.0)[1]
        assert np.flatnonzero(wrong).tolist() == [place - window.start]


@pytest.mark.parametrize("motion", ["square, 2", "square, 25", "prbs, 3", "stop-and-go", "multisine"])
@pytest.mark.parametrize("axis", ["cart", "spindle", "shuttle"])
def test_no_count_of_a_clean_motion_is_called_wrong(axis: str, motion: str) -> None:
    for increments in (16384, 256):
        case = case_of(axis, motion, increments)
        assert run(case, case.counts)[2].mean() <= 0.001


def test_the_recursion_has_the_bits_of_the_repaired_record() -> None:
    """One rule, off-line and on-line, finds the same counts. No count of this record is unsure."""
    rng = np.random.default_rng(5)
    case = case_of("cart", "prbs", 1024)
    places = wrong_places("uniform", 0.02, rng)
    counts = case.counts + 7_000 * (np.arange(case.counts.size) >= 1200)
    counts[places] += wrong_sizes("uniform", 5000, places.size, rng)
    repaired, wrong, _ = find_outliers(counts, np.arange(counts.size, dtype=float), 1.0)
    guarded = case.estimator.start().run(case.u, counts)
    plain = replace(case.estimator, encoder=replace(case.estimator.encoder, guard=False))
    track = plain.start().run(case.u, repaired)
    assert plain.delay == 0
    assert case.estimator.delay == DELAY
    assert np.array_equal(guarded.has_status(Status.COUNT_JUMP)[DELAY:], wrong[:-DELAY])
    assert not guarded.has_status(Status.SETTLING)[100:].any()
    assert wrong.sum() > 8
    assert np.array_equal(guarded.theta[DELAY:], track.theta[:-DELAY])


@pytest.mark.parametrize("limit", [1.0, 1.5])
def test_the_highest_speed_is_a_hard_limit(limit: float) -> None:
    """Thirty wrong counts in a row may look like a motion, but like none that the axis can do."""
    u = prbs(1500, clock=10, amplitude=3.0, rng=np.random.default_rng(4))
    y, resolution = simulate_drive(CART, u, CART_DT).x, resolution_of(4096)
    counts = quantize(y, resolution)
    top = float(np.abs(np.diff(counts)).max()) * resolution / CART_DT
    make_one = lambda speed: RLS(Drive(2.0), Encoder(resolution, max_speed=speed), CART_DT, 50.0, forgetting=0.995)  # noqa: E731
    clean = make_one(None).start().run(u, counts)
    assert np.array_equal(make_one(limit * top).start().run(u, counts).theta, clean.theta)
    counts[700:705] += np.arange(1, 6) * 2 * round(top * CART_DT / resolution)
    flagged = np.flatnonzero(make_one(limit * top).start().run(u, counts).has_status(Status.COUNT_JUMP))
    assert set(range(700 + DELAY, 705 + DELAY)) <= set(flagged)


def wrong_record(seed: int, largest: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return clusters of wrong counts, a reset, and 60 samples that are all wrong."""
    rng = np.random.default_rng([seed, largest])
    case = case_of("cart", "prbs", (4096, 256)[seed % 2])
    counts, places = case.counts[:1500].copy(), wrong_places("clustered", 0.03, rng)
    places = places[places < 1000]
    counts[places] += wrong_sizes("uniform", largest, places.size, rng)
    counts[1100:] += 5 * largest
    counts[1250:1310] += rng.integers(-largest, largest + 1, 60)
    return case.u[:1500], counts


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cls", [RLS, RIV])
def test_wrong_counts_have_the_same_bits_side_by_side(cls: type[RLS], precision: Any) -> None:
    records = [wrong_record(seed, largest) for seed in (0, 1, 2) for largest in (5, 20, 300, 10**6)]
    one = cls(Drive(2.0), Encoder(2e-5), 0.01, 50.0, forgetting=0.995, precision=precision)
    tracks = pmfid.Fleet(one, 12, workers=1).run(
        np.stack([u for u, _ in records]), np.stack([counts for _, counts in records]), every=1
    )
    for axis, (u, counts) in enumerate(records):
        alone = one.start().run(u, counts)
        assert np.array_equal(tracks.theta[axis], alone.theta)
        assert np.array_equal(tracks.status[axis], alone.status)


METHODS = (RIV, BCRLS, RLS)
SUSPICIOUS = Status.COUNT_JUMP | Status.INVALID_INPUT
#: Samples for which the guard waits.
KINDS = ("jump", "glitch", "1 % glitches", "spike")
DT, CUTOFF, FORGETTING = 0.01, 50.0, 0.998


def estimator(cls: Any, resolution: float, **options: Any) -> Any:
    encoder = Encoder(resolution, **{key: options.pop(key) for key in ("guard", "bits") if key in options})
    return cls(Drive(2.0), encoder, DT, CUTOFF, **({"forgetting": FORGETTING} | options))


NUMBERS = ("theta", "variance_factor", "inflation", "innovation", "innovation_variance", "status")


def the_same(a: Any, b: Any, delay: int = 0) -> bool:
    """Return whether two tracks have the same bits, the first one `delay` samples later."""
    n = a.status.size
    return all(np.array_equal(getattr(a, name)[delay:], getattr(b, name)[: n - delay]) for name in NUMBERS)


@dataclass(frozen=True)
class Spoiled:
    """A record with faults at places (k,), beyond the first third."""

    u: NDArray[np.float64]
    counts: NDArray[np.int64]
    places: NDArray[np.intp]


def spoil(kind: str, u: NDArray[np.float64], counts: NDArray[np.int64], rng: np.random.Generator) -> Spoiled:
    """Return a record of (n,) samples with a fault of this kind at a random place."""
    u, counts, n = u.copy(), counts.copy(), u.size
    places = np.array([rng.integers(n // 3, n - 100)])
    if kind == "1 % glitches":
        places = n // 3 + np.flatnonzero(rng.random(n - n // 3) < 0.01)
    sizes = rng.choice([-1, 1], places.size) * 10 ** rng.uniform(2.0, 9.0, places.size)
    if kind == "spike":
        u[places] = 100 * sizes
    elif kind == "jump":
        counts[places[0] :] += round(float(sizes[0]))
    else:
        counts[places] += sizes.astype(np.int64)
    return Spoiled(u, counts, places)


@pytest.mark.parametrize("cls", METHODS)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_after_a_jump_it_goes_on_from_the_new_zero(cls: Any, precision: str) -> None:
    run = cart_run(9, samples=3000)
    counts = run.counts + 123_456 * (np.arange(3000) >= 2013)  # just before a change of the acceleration
    track = estimator(cls, run.encoder.resolution, precision=precision).run(run.u, counts)
    assert np.flatnonzero(track.has_status(Status.COUNT_JUMP)).tolist() == [2013 + DELAY]
    assert not track.has_status(Status.SETTLING)[2013:].any()
    np.testing.assert_allclose(track.theta[2013:], np.broadcast_to(TRUTH, (987, 3)), rtol=0.05)


# --- valid samples stay unchanged ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("increments", [4096, 64])
def test_what_nobody_spoiled_keeps_its_bits(name: str, increments: int) -> None:
    run = make_scenario(name, seed=8, increments=increments)
    with_guard, without = (
        estimator(RIV, run.resolution, guard=on).run(run.motion.u, run.counts) for on in (True, False)
    )
    assert the_same(with_guard, without, DELAY)


def test_a_blow_is_a_motion() -> None:
    """A jump of the velocity lowers its acceleration by 3 at most if a sample is left out."""
    u = prbs(3000, clock=10, amplitude=3.0, rng=np.random.default_rng(4))
    late = (np.arange(3000) - 2500) * DT
    after_blow = np.where(late > 0, 0.5 / 12 * (1 - np.exp(-12 * np.maximum(late, 0.0))), 0.0)
    counts = quantize(simulate_drive(CART, u, DT).x + after_blow, resolution_of(4096))
    assert not estimator(RLS, resolution_of(4096)).run(u, counts).has_status(SUSPICIOUS).any()


# --- a counter that is set on purpose ---------------------------------------------------------------------------------


# --- the other builds of the kernel -----------------------------------------------------------------------------------


def spoiled_fleet(axes: int, samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    rng, rows = np.random.default_rng(1), []
    for axis in range(axes):
        run = cart_run(axis, increments=(4096, 256, 64)[axis % 3], samples=samples)
        spoiled = spoil(KINDS[axis % 4], np.r_[run.u, run.u], np.r_[run.counts, run.counts], rng)
        rows.append((spoiled.u[samples // 2 :][:samples], spoiled.counts[samples // 2 :][:samples]))
    return np.stack([u for u, _ in rows]), np.stack([counts for _, counts in rows])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cls", [RIV, BCRLS])
def test_side_by_side_each_axis_has_its_own_bits(cls: Any, precision: str, way: int, monkeypatch: Any) -> None:
    u, counts = spoiled_fleet(13)
    one = estimator(cls, resolution_of(1024), precision=precision)
    fleet = pmfid.Fleet(one, 13, workers=1)
    monkeypatch.setattr(fleet, "_way", way)
    tracks = fleet.run(u, counts, every=1)
    for axis in range(13):
        one.reset()
        alone = one.run(u[axis], counts[axis])
        assert np.array_equal(tracks.theta[axis], alone.theta)
        assert np.array_equal(tracks.status[axis], alone.status)
        assert alone.has_status(SUSPICIOUS).any()


@pytest.mark.parametrize(
    ("cls", "guard", "target"),
    long_unless(
        lambda cls, guard, target: guard and cls is RIV and target is GCC,
        product([RIV, BCRLS], [True, False], [GCC, M4F]),
    ),
    ids=lambda value: value.name if isinstance(value, Target) else None,
)
def test_firmware_has_the_same_bits(cls: Any, guard: bool, target: Target, tmp_path: Path) -> None:
    if target.missing:
        pytest.skip(target.missing)
    u, counts = spoiled_fleet(4)
    one = estimator(cls, resolution_of(1024), precision="float32", guard=guard)
    folder = exported(one, tmp_path, np.concatenate(u), np.concatenate(counts))
    assert difference(folder, target, "-O0") is None
    assert f"#define PMF_WITH_GUARD {int(guard)}" in (folder / "pmf_sizes.h").read_text()


# --- off-line ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", [LS, IV])
@pytest.mark.parametrize("kind", KINDS)
def test_off_line_they_are_left_out_as_well(cls: Any, kind: str) -> None:
    record = machine_record(AXES["rotary"], "nothing", "prbs", 1024, 4)
    axis = AXES["rotary"]
    method = cls(Drive(axis.drive.input_gain), Encoder(record.resolution), axis.dt, 0.5 / axis.dt)
    spoiled = spoil(kind, record.u, record.counts, np.random.default_rng(3))
    clean, fit = method.fit(record.u, record.counts), method.fit(spoiled.u, spoiled.counts)
    assert fit.status & SUSPICIOUS
    np.testing.assert_allclose(fit.theta, clean.theta, rtol=0.02)


# --- the monitor ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_monitor_watches_on(calibration: Calibration, kind: str) -> None:
    """The only alarm is the alarm on the mass, ten seconds later."""
    step = Schedule(((0.0, CART), (25.0, replace(CART, mass=1.2 * CART.mass))))
    u, counts = changing(step, 4, 1024, 40.0)
    spoiled = spoil(kind, u[:3500], counts[:3500], np.random.default_rng(6))
    counts = np.r_[spoiled.counts, counts[3500:] + spoiled.counts[-1] - counts[3499]]
    u = np.r_[spoiled.u, u[3500:]]
    monitor = Monitor(make_riv(1024, TRUTH), calibration, Watch())
    events = [event for a, b in zip(u.tolist(), counts.tolist(), strict=True) for event in monitor.step(a, b)[1]]
    (alarm,) = [event for event in events if isinstance(event, Alarm)]
    assert alarm.parameter == "mass"
    assert alarm.relative == pytest.approx(0.2, abs=0.05)
    assert 25.0 < alarm.time < 28.0
    outliers = [event for event in events if isinstance(event, Outlier)]
    assert len(outliers) >= 0.9 * spoiled.places.size
    if spoiled.places.size == 1:
        (outlier,) = outliers
        assert outlier.signal == ("input" if kind == "spike" else "counts")
        assert outlier.time == pytest.approx(spoiled.places[0] * CART_DT)
