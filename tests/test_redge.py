"""The recursion over edges, against machines whose parameters are known, and its saved states."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from pmfid import Drive, Encoder, REdge, Status, UsageError
from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.kernel.saved import _write_saved, edge_configuration, tight_edge_structures
from pmfid.simulation import CART, DriveParameters, Machine, capture_edges, drive_machine, prbs, simulate_drive
from tests.conftest import TRUTH
from tests.refusals import refused

HOSTILE = (0.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40)


DT, EVERY = 0.01, 10
HEAVY = DriveParameters(300.0, 200.0, 90.0, 100.0)


def swing(turn: int = 16, samples: int = 2000, off: float = 0.0, seed: int = 11, drive: DriveParameters = CART):
    """Return input, counts and ages of a drive on a wheel with `turn` lines, and the resolution."""
    rng = np.random.default_rng(seed)
    u = prbs(samples, clock=10 if drive.mass < 10 else 40, amplitude=4.0, rng=rng) + drive.offset / drive.input_gain
    motion = simulate_drive(drive, np.repeat(u, EVERY), DT / EVERY)
    step = (0.0931 if drive.mass < 10 else 0.4) / turn
    errors = off * step * rng.uniform(-1.0, 1.0, turn)
    counts, ages = capture_edges(motion, step, 0.3 * step, every=EVERY, tick=1e-6, line_errors=errors)
    return u, counts, ages, step


def estimator_of(step: float, turn: int | None = 16, gain: float = CART.input_gain, **options) -> REdge:
    return REdge(Drive(gain), Encoder(step), DT, lines=turn, tick=1e-6, **options)


@pytest.mark.parametrize(("turn", "off"), [(16, 0.0), (16, 0.03), (64, 0.01), (1024, 0.01)])
def test_few_lines_give_a_mass_to_a_hundred_thousandth(turn: int, off: float) -> None:
    u, counts, ages, step = swing(turn, off=off)
    estimate = estimator_of(step, turn)
    track = estimate.run(u, counts, ages)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=3e-5)
    assert np.all(np.abs(track.theta[-1] - TRUTH) < 4 * track.theta_std[-1])
    assert track.theta_std[-1, 0] < 3e-5 * TRUTH[0]
    assert track.status[-1] == 0
    assert np.array_equal(estimate.theta, track.theta[-1])
    assert np.array_equal(estimate.theta_std, track.theta_std[-1])


@pytest.mark.parametrize(("turn", "seed"), [(512, 20), (512, 22), (64, 21), (64, 25)])
def test_lines_that_are_far_off_are_within_the_standard_errors(turn: int, seed: int) -> None:
    u, counts, ages, step = swing(turn, off=0.1, seed=seed, drive=HEAVY)
    track = estimator_of(step, turn, HEAVY.input_gain).run(u, counts, ages)
    truth = [HEAVY.mass, HEAVY.viscous_friction, HEAVY.coulomb_friction]
    assert np.all(np.abs(track.theta[-1] - truth) < 4 * track.theta_std[-1])
    assert track.theta_std[-1, 0] < 1e-4 * HEAVY.mass


@pytest.mark.parametrize("weight", [0.0, 0.3, -9.0])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_constant_force_is_found(weight: float, precision: str) -> None:
    """Of an axis whose weight is nothing, less than its friction, and far more than its friction."""
    drive = replace(CART, offset=weight)
    u, counts, ages, step = swing(16, off=0.01, drive=drive)
    estimator = REdge(Drive(2.0, offset=True), Encoder(step), DT, lines=16, tick=1e-6, precision=precision)
    track = estimator.run(u, counts, ages)
    error = track.theta[-1] - [*TRUTH, weight]
    assert np.all(np.abs(error) < (3e-5 if precision == "float64" else 2e-3) * np.maximum(np.abs([*TRUTH, weight]), 1))
    assert np.all(np.abs(error) < 4 * track.theta_std[-1])
    assert track.status[-1] == 0
    resumed = pickle.loads(pickle.dumps(estimator))
    assert np.array_equal(resumed.theta, estimator.theta)


def test_lines_that_do_not_repeat_are_noise() -> None:
    u, counts, ages, step = swing(64, off=0.01)
    track = estimator_of(step, None).run(u, counts, ages)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=2e-2)
    assert track.theta_std[-1, 0] > 1e-5 * TRUTH[0]


@pytest.mark.parametrize("seed", [20, 21, 25])
def test_single_precision_does_not_drift_over_dense_edges(seed: int) -> None:
    u, counts, ages, step = swing(512, off=0.01, samples=3000, seed=seed, drive=HEAVY)
    track = estimator_of(step, 512, HEAVY.input_gain, precision="float32").run(u, counts, ages)
    assert not np.any(track.status[1000:])
    assert track.theta[-1, 0] == pytest.approx(HEAVY.mass, rel=1e-4)


def test_a_mass_that_changes_is_followed() -> None:
    before, after = swing(64, seed=1), swing(64, seed=2, drive=DriveParameters(1.44, 12.8, 0.8, CART.input_gain))
    estimator = estimator_of(before[3], 64)
    estimator.run(*before[:3])
    counts = after[1] - after[1][0] + before[1][-1]
    track = estimator.run(after[0], counts, after[2])
    assert track["mass"][0] == pytest.approx(1.07, rel=1e-4)
    assert np.all(np.abs(track["mass"][300:] / 1.44 - 1) < 0.05)
    assert track["mass"][-1] == pytest.approx(1.44, rel=1e-3)


def test_a_wrong_model_is_flagged() -> None:
    rng = np.random.default_rng(5)
    u = prbs(3000, clock=10, amplitude=4.0, rng=rng)
    motion = simulate_drive(CART, np.repeat(u + 0.2 * (u > 0), EVERY), DT / EVERY)
    counts, ages = capture_edges(motion, 0.0058, every=EVERY, tick=1e-6)
    track = estimator_of(0.0058).run(u, counts, ages)
    assert np.mean(track.status[1000:] != 0) > 0.5


@pytest.mark.parametrize("seed", [3, 7])
def test_friction_that_grows_with_the_square_of_the_speed_is_flagged(seed: int) -> None:
    turn, u = 16, prbs(3000, clock=40, amplitude=4.0, rng=np.random.default_rng(seed))
    machine, step = Machine(HEAVY, quadratic=0.01 * HEAVY.viscous_friction), 0.4 / turn
    motion = drive_machine(machine, np.repeat(u, EVERY), DT / EVERY, step, steps=2)
    path = Trajectory(DT / EVERY * np.arange(motion.x.size), motion.x, motion.v)
    counts, ages = read_edge_times(path, Lattice(step, 0.3 * step, np.zeros(turn)), EVERY, 1e-6)
    track = estimator_of(step, turn, HEAVY.input_gain).run(u, counts, ages)
    assert np.mean(track.status[1000:] != 0) > 0.95


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_single_edges_that_are_far_off_teach_nothing(precision: str) -> None:
    u, counts, ages, step = swing(64, off=0.01)
    ages[np.flatnonzero(np.isfinite(ages))[200::97]] *= 0.7
    track = estimator_of(step, 64, precision=precision).run(u, counts, ages)
    np.testing.assert_allclose(track.theta[-1], TRUTH, rtol=1e-5 if precision == "float64" else 3e-4)
    assert track.status[-1] == 0


def test_rest_changes_nothing() -> None:
    u, counts, ages, step = swing()
    estimator = estimator_of(step)
    estimator.run(u, counts, ages)
    before = estimator.theta
    rest = np.full(5000, counts[-1])
    track = estimator.run(np.zeros(5000), rest, np.full(5000, np.nan))
    np.testing.assert_allclose(track.theta[-1], before, rtol=1e-6)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_parts_have_the_bits_of_the_whole(precision: str) -> None:
    u, counts, ages, step = swing(samples=1200, off=0.01)
    whole = estimator_of(step, precision=precision).run(u, counts, ages)
    first = estimator_of(step, precision=precision)
    first.run(u[:700], counts[:700], ages[:700])
    resumed = estimator_of(step, precision=precision)
    resumed.set_state(first.get_state())
    for other in (resumed, pickle.loads(pickle.dumps(first)), copy.deepcopy(first)):
        stepped = [other.step(*sample).theta for sample in zip(u[700:], counts[700:].tolist(), ages[700:], strict=True)]
        assert np.array_equal(stepped, whole.theta[700:])
    first.reset()
    assert first.get_state() == estimator_of(step, precision=precision).get_state()


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_nothing_but_numbers_leaves_the_kernel(precision: str) -> None:
    rng = np.random.default_rng(8)
    u, counts, ages, step = swing(samples=1500)
    hostile = rng.random(u.size) < 0.02
    u[hostile], ages[rng.random(u.size) < 0.02] = rng.choice(HOSTILE, hostile.sum()), rng.choice(HOSTILE)
    counts[rng.random(u.size) < 0.01] += rng.integers(-(2**40), 2**40)
    track = estimator_of(step, precision=precision).run(u, counts, ages)
    assert np.all(np.isfinite(track.theta))
    assert not np.any(np.isnan(track.theta_std))
    assert np.any(track.status & Status.INVALID_INPUT)


def test_foreign_and_damaged_states_are_refused() -> None:
    estimator = estimator_of(1e-3)
    state = estimator.get_state()
    refused(
        ("not a state of this configuration", lambda: estimator.set_state(estimator_of(2e-3).get_state())),
        ("damaged", lambda: estimator.set_state(state[:-1] + b"\x01")),
        ("not a state of this configuration", lambda: estimator.set_state(b"")),
    )
    assert estimator.get_state() == state


SAMPLES, CUT = 400, 340
INPUT = prbs(SAMPLES, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
COUNTS, AGES = capture_edges(simulate_drive(CART, np.repeat(INPUT, 10), 1e-3), 0.0015, every=10, tick=1e-6)
LARGE = {"float64": (1e300, -1e30), "float32": (1e38, -1e30)}


def list_reals(kind: np.dtype, prefix: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
    """Yield the path of each real number in a structure."""
    for name in kind.names or ():
        base, shape = kind[name].subdtype or (kind[name], ())
        for index in np.ndindex(*shape):
            path = (*prefix, name, *((index,) if shape else ()))
            if base.names:
                yield from list_reals(base, path)
            elif base.kind == "f":
                yield path


def make(precision: str) -> REdge:
    return REdge(Drive(CART.input_gain), Encoder(0.0015), 0.01, tick=1e-6, memory=10.0, precision=precision)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_number_out_of_range_is_refused_or_harmless(precision: str) -> None:
    """States with a reference of 1e30 or a negative number of edges once ended in infinite estimates."""
    estimator = make(precision)
    for k in range(CUT):
        estimator.step(INPUT[k], int(COUNTS[k]), float(AGES[k]))
    configuration = edge_configuration(estimator.kernel, precision)
    types = tight_edge_structures(configuration, precision)
    saved = np.frombuffer(estimator.get_state(), types["pmf_saved_t"])
    refused = 0
    for path in list_reals(types["pmf_state_t"]):
        for value in LARGE[precision]:
            damaged = saved.copy()
            place = damaged[0]["state"]
            for key in path[:-1]:
                place = place[key]
            place[path[-1]] = value
            other = make(precision)
            try:
                other.set_state(_write_saved(configuration, damaged[0]["state"], types))
            except UsageError:
                refused += 1
                continue
            with np.errstate(all="ignore"):
                for k in range(CUT, SAMPLES):
                    estimate = other.step(INPUT[k], int(COUNTS[k]), float(AGES[k]))
                    assert np.all(np.isfinite(estimate.theta)), (path, value)
    assert refused > 100
