"""Samples that no motion explains are flagged and kept out, and all other samples stay unchanged."""

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
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Outlier, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import CART, CART_DT, Schedule, make_scenario, quantize, resolution_of, simulate_drive
from pmfid.simulation.scenarios import SCENARIOS
from pmfid.simulation.signals import prbs
from studies.machines import AXES, machine_record
from studies.monitoring.axis import changing, make_riv, normal_work
from tests.conftest import TRUTH, cart_run, long_unless
from tests.firmware.build import GCC, M4F, Target, command
from tests.firmware.footprint import flash
from tests.firmware.replay import difference, exported
from tests.test_many import WAYS

METHODS = (RIV, BCRLS, RLS)
SUSPICIOUS = Status.COUNT_JUMP | Status.INVALID_INPUT
#: Samples for which the guard waits.
DELAY = 8
KINDS = ("jump", "glitch", "1 % glitches", "spike")
DT, CUTOFF, FORGETTING = 0.01, 50.0, 0.998


#: A rotary axis: kg m2, N m s, N m, N m/V.
SMALL = {"mass": 2e-3, "viscous_friction": 0.02, "coulomb_friction": 0.05, "input_gain": 0.2}


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
    counts = run.counts + 123_456 * (np.arange(3000) >= 2000)
    track = estimator(cls, run.encoder.resolution, precision=precision).run(run.u, counts)
    assert np.flatnonzero(track.has_status(Status.COUNT_JUMP)).tolist() == [2000 + DELAY]
    assert not track.has_status(Status.SETTLING)[2000:].any()
    np.testing.assert_allclose(track.theta[2000:], np.broadcast_to(TRUTH, (1000, 3)), rtol=0.05)


@pytest.mark.parametrize("place", [120, 250])
def test_a_wrong_count_early_in_a_smooth_motion_hides_no_later_ones(place: int) -> None:
    """A smooth motion is fully predicted. The guard once learned nothing from such a motion, and after a first wrong
    count let all others pass.
    """
    t = np.arange(4000) * 0.005
    u = 1.2 * np.sin(1.4 * t) + 0.8 * np.sin(3.8 * t + 1.0) + 0.5 * np.sin(8.2 * t + 2.0)
    resolution = 2 * np.pi / 4096
    counts = quantize(simulate_drive(replace(CART, **SMALL), u, 0.005).x, resolution)
    counts[place] += 100_000
    jumps = np.arange(1000, 4000, 200)
    counts += 20_000 * np.searchsorted(jumps, np.arange(4000), side="right")
    track = RIV(Drive(SMALL["input_gain"]), Encoder(resolution), 0.005, 50.0, forgetting=0.998).run(u, counts)
    assert track.has_status(Status.COUNT_JUMP)[np.array([place, *jumps]) + DELAY].all()
    assert track.theta[-1, 0] == pytest.approx(SMALL["mass"], rel=0.01)


@pytest.mark.parametrize("bits", [10, 16])
def test_a_narrow_counter_wraps_through_it(bits: int) -> None:
    run = cart_run(9, samples=3000)
    counts = run.counts + 300 * (np.arange(3000) >= 2000)
    counts[1500] -= 333
    whole = estimator(BCRLS, run.encoder.resolution).run(run.u, counts)
    narrow = estimator(BCRLS, run.encoder.resolution, bits=bits).run(run.u, counts % 2**bits)
    assert np.flatnonzero(narrow.has_status(Status.COUNT_JUMP)).tolist() == [1500 + DELAY, 2000 + DELAY]
    assert the_same(whole, narrow)


# --- valid samples stay unchanged ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("increments", [4096, 64])
def test_what_nobody_spoiled_keeps_its_bits(name: str, increments: int) -> None:
    run = make_scenario(name, seed=8, increments=increments)
    with_guard, without = (
        estimator(RIV, run.resolution, guard=on).run(run.motion.u, run.counts) for on in (True, False)
    )
    assert the_same(with_guard, without, DELAY)


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0, 100.0])
@pytest.mark.parametrize("increments", [4096, 256])
def test_another_amplitude_of_the_input_passes(factor: float, increments: int) -> None:
    """At most a few samples are replaced."""
    u = prbs(4000, clock=10, amplitude=1.0, rng=np.random.default_rng(4)) * np.r_[np.ones(2000), np.full(2000, factor)]
    u *= 3.0 / min(1.0, factor)
    counts = quantize(simulate_drive(CART, u, DT).x, resolution_of(increments))
    with_guard, without = (estimator(RIV, resolution_of(increments), guard=on).run(u, counts) for on in (True, False))
    assert np.sum(with_guard.has_status(SUSPICIOUS)) <= 4
    np.testing.assert_allclose(with_guard.theta[2500 + DELAY :], without.theta[2500:-DELAY], rtol=0.01)


def test_a_blow_is_a_motion() -> None:
    """A jump of the velocity lowers its acceleration by 3 at most if a sample is left out."""
    u = prbs(3000, clock=10, amplitude=3.0, rng=np.random.default_rng(4))
    late = (np.arange(3000) - 2500) * DT
    after_blow = np.where(late > 0, 0.5 / 12 * (1 - np.exp(-12 * np.maximum(late, 0.0))), 0.0)
    counts = quantize(simulate_drive(CART, u, DT).x + after_blow, resolution_of(4096))
    assert not estimator(RLS, resolution_of(4096)).run(u, counts).has_status(SUSPICIOUS).any()


# --- a counter that is set on purpose ---------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", METHODS)
@pytest.mark.parametrize("guard", [True, False])
def test_a_known_homing_changes_nothing(cls: Any, guard: bool) -> None:
    run = cart_run(3, samples=1500)
    whole = estimator(cls, run.encoder.resolution, guard=guard).run(run.u, run.counts)
    homed = estimator(cls, run.encoder.resolution, guard=guard)
    homed.run(run.u[:1000], run.counts[:1000])
    homed.rebase(int(run.counts[999]) - 98_765)
    rest = homed.run(run.u[1000:], run.counts[1000:] - 98_765)
    assert np.array_equal(rest.theta, whole.theta[1000:])
    assert np.array_equal(rest.status, whole.status[1000:])


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
    assert difference(folder, target, "-O2") is None
    assert f"#define PMF_WITH_GUARD {int(guard)}" in (folder / "pmf_sizes.h").read_text()


@pytest.mark.long
def test_without_the_guard_firmware_is_as_small_as_before(tmp_path: Path) -> None:
    if M4F.missing:
        pytest.skip(M4F.missing)
    size = {}
    for guard in (True, False):
        folder = tmp_path / str(guard)
        pmfid.export_firmware(estimator(BCRLS, 1e-4, precision="float32", guard=guard), folder)
        size[guard] = flash(folder, "axis", M4F)
    assert 500 < size[True] - size[False] < 4300


def test_firmware_can_be_homed(tmp_path: Path) -> None:
    if GCC.missing:
        pytest.skip(GCC.missing)
    pmfid.export_firmware(estimator(BCRLS, 1e-4), tmp_path)
    (tmp_path / "homing.c").write_text(
        '#include "axis.h"\nint main(void)\n{\n    axis_t axis;\n    axis_init(&axis);\n'
        "    (void)axis_step(&axis, PMF_R(0.0), 70000U);\n    axis_rebase(&axis, 0U);\n"
        "    return (int)(axis_step(&axis, PMF_R(0.0), 1U) & PMF_COUNT_JUMP);\n}\n"
    )
    sources = [path.name for path in tmp_path.glob("pmf_*.c")]
    flags = ["-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    built = command(["gcc", *flags, *sources, "axis_config.c", "homing.c", "-o", "homing"], tmp_path)
    assert built.returncode == 0, built.stderr
    assert command(["./homing"], tmp_path).returncode == 0


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


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    u, counts = normal_work(7, 1024, 0.2)
    return calibrate(make_riv(1024), TRUTH, u, counts, hours=4.0)


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


def test_a_monitor_can_be_homed(calibration: Calibration) -> None:
    u, counts = changing(Schedule(((0.0, CART),)), 4, 1024, 10.0)
    plain, homed = (Monitor(make_riv(1024, TRUTH), calibration, Watch()) for _ in range(2))
    for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)):
        if k == 500:
            homed.rebase(int(counts[499]) - 10**6)
        one, other = plain.step(a, b)[0], homed.step(a, b - (10**6 if k >= 500 else 0))[0]
    assert np.array_equal(one.theta, other.theta)


def test_samples_lost_while_the_input_switches_are_not_drawn_as_lines(calibration):
    """The instant of the input's switch is unknown. A straight line through the switch led to Coulomb friction below
    zero.
    """
    u, counts = normal_work(3, 1024, 0.02)
    for jump, settles in ((0.0, False), (20.0, True)):
        monitor = Monitor(make_riv(1024, TRUTH), calibration, Watch())
        for pair in zip(u[:1500], counts[:1500].tolist(), strict=True):
            monitor.step(*pair)
        monitor.fill_gap(2, u[1502] + jump * np.ptp(u), int(counts[1502]))
        status = Status(0)
        for k in range(1502, 1502 + DELAY):
            status |= Status(monitor.step(u[k], int(counts[k]))[0].status)
        assert (Status.SETTLING in status) == settles


def test_a_held_input_that_switched_in_lost_samples_is_not_drawn_as_a_line_either(calibration: Calibration) -> None:
    """The change over four samples is no larger than usual. An earlier version learned from the interpolated input."""
    rng = np.random.default_rng(5)
    u = prbs(1700, clock=10, amplitude=3.0, rng=rng)
    counts = quantize(simulate_drive(CART, u, CART_DT).x, resolution_of(1024)).tolist()
    for switched in (False, True):
        first = next(k for k in range(1500, 1690) if (u[k - 1] != u[k + 4]) == switched and u[k - 1] == u[k])
        monitor = Monitor(make_riv(1024, TRUTH), calibration, Watch())
        for k in range(first):
            monitor.step(float(u[k]), counts[k])
        monitor.fill_gap(4, float(u[first + 4]), counts[first + 4])
        estimate, _ = monitor.step(float(u[first + 4]), counts[first + 4])
        assert (Status.SETTLING in Status(estimate.status)) == switched
