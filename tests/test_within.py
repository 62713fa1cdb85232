"""`riv` finds a dead time by a motion that is held within the counts, and flags it as unknown until then."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pmfid import RIV, Drive, Encoder, Status
from pmfid.estimators.results import Track
from pmfid.kernel.structures import constants_of, structures
from pmfid.simulation import Machine, control_machine, drive_machine, prbs, stop_and_go
from pmfid.simulation.drive import DriveParameters, MachineRun

#: Gain, mass, viscous and Coulomb friction, sample period, stroke, time of a move and of a rest, kp, kd, largest input.
LIFT = (58.0, 40.0, 100.0, 15.0, 0.002, 0.2, 0.5, 0.2, 400.0, 30.0, 30.0)
CARRIAGE = (2.0, 1.07, 12.8, 0.8, 0.01, 0.2, 0.8, 0.5, 200.0, 5.0, 6.0)
AXES = {"lift": (LIFT, 1.6e-4), "carriage": (CARRIAGE, 3.64e-4)}
UNKNOWN = Status.DEAD_TIME | Status.FALLBACK | Status.STARTING


@cache
def moved(axis: str, late: float, seed: int = 1, samples: int = 2000, coarse: float = 1.0) -> MachineRun:
    """Simulate position control through the encoder, from place to place."""
    (gain, mass, viscous, coulomb, dt, stroke, move, rest, kp, kd, most), step = AXES[axis]
    rng = np.random.default_rng([seed, 31])
    machine = Machine(DriveParameters(mass, viscous, coulomb, gain), dead_time=late * dt)
    reference = stop_and_go(samples, dt, stroke * rng.uniform(0.9, 1.1), move, rest)
    phase = rng.uniform(0, coarse * step)
    return control_machine(machine, reference, dt, coarse * step, kp=kp, kd=kd, u_max=most, phase=phase)


def tracked(axis: str, run: MachineRun, coarse: float = 1.0, precision: str = "float64") -> Track:
    (gain, *_), step = AXES[axis]
    dt = AXES[axis][0][4]
    model = Drive(gain, dead_time="estimate")
    return RIV(model, Encoder(coarse * step), dt, 0.2 / dt, precision=precision).run(run.u, run.counts)


def truth(axis: str, late: float) -> np.ndarray:
    _, mass, viscous, coulomb, dt, *_ = AXES[axis][0]
    return np.array([mass, viscous, coulomb, late * dt])


@pytest.mark.parametrize("late", [0.0, 0.6, 2.3])
@pytest.mark.parametrize("axis", AXES)
def test_under_control_it_is_found_and_the_rest_is_as_without_one(axis: str, late: float) -> None:
    """The instrument of the input's change once gave a dead time tenths of a sample off, or none."""
    track, true = tracked(axis, moved(axis, late)), truth(axis, late)
    dt = AXES[axis][0][4]
    assert not Status(int(track.status[-1])) & UNKNOWN
    assert track.theta[-1, 3] / dt == pytest.approx(late, abs=0.05)
    assert abs(track.theta[-1, 3] - true[3]) < 4 * track.theta_std[-1, 3]
    np.testing.assert_array_less(np.abs(track.theta[-1, :3] / true[:3] - 1), [0.01, 0.03, 0.1])


def test_numbers_of_32_bits_do() -> None:
    track = tracked("carriage", moved("carriage", 0.6), precision="float32")
    assert track.theta[-1, 3] / 0.01 == pytest.approx(0.6, abs=0.05)


@pytest.mark.parametrize(("axis", "late", "seed"), [("carriage", 1.7, 2), ("carriage", 0.0, 3), ("lift", 2.3, 1)])
def test_what_is_not_known_is_said_and_within_reach(axis: str, late: float, seed: int) -> None:
    """The encoder is four times as coarse. An earlier version found a dead time of many samples without a flag."""
    track = tracked(axis, moved(axis, late, seed, 1200, 4.0), 4.0)
    dt = AXES[axis][0][4]
    started = (track.status & int(Status.STARTING)) == 0
    found, room = track.theta[started, 3] / dt, constants_of(None)["PMF_MAX_LATE"] - 2
    assert np.all((found >= 0) & (found <= room))
    silent = (track.status[started] & int(UNKNOWN)) == 0
    wrong = np.abs(found - late) > np.maximum(0.02, 6 * track.theta_std[started, 3] / dt)
    assert np.mean(wrong & silent) < 0.02


def test_one_that_jumps_is_said_at_once_and_followed() -> None:
    """Without forgetting, the counts contradict the old dead time. The velocity jumps between the two runs, so that the
    filters first settle again."""
    parameters = DriveParameters(1.07, 12.8, 0.8, 2.0)
    parts = []
    for late, seed in ((0.4, 1), (1.6, 2)):
        rng = np.random.default_rng(seed)
        u = prbs(2000, clock=9, amplitude=3.0, rng=rng)
        parts.append(
            drive_machine(Machine(parameters, dead_time=late * 0.01), u, 0.01, 2e-4, phase=1e-4 * rng.random())
        )
    first, second = parts
    u = np.r_[first.u, second.u]
    counts = np.r_[first.counts, second.counts - second.counts[0] + first.counts[-1]]
    track = RIV(Drive(2.0, dead_time="estimate"), Encoder(2e-4), 0.01, 20.0).run(u, counts)
    assert track.theta[1999, 3] / 0.01 == pytest.approx(0.4, abs=0.02)
    settled = 2000 + int(np.flatnonzero(track.status[2010:] == 0)[0]) + 10
    assert settled <= 2080
    assert np.any(track.status[settled : settled + 60] & int(UNKNOWN))
    assert track.theta[-1, 3] / 0.01 == pytest.approx(1.6, abs=0.02)
    np.testing.assert_allclose(track.theta[-1, :3], truth("carriage", 0)[:3], rtol=0.05)


def test_variances_and_covariance_say_the_same() -> None:
    run = moved("carriage", 0.6)
    estimator = RIV(Drive(2.0, dead_time="estimate"), Encoder(AXES["carriage"][1]), 0.01, 20.0)
    estimator.run(run.u, run.counts)
    estimate = estimator.estimate
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.theta_cov)), estimate.theta_std, rtol=1e-6)
    assert np.all(np.linalg.eigvalsh(estimate.theta_cov) > 0)


def test_the_advice_helps_where_it_is_estimated_already() -> None:
    (advice,) = Status.DEAD_TIME.advice
    assert 'dead_time = "estimate"' in advice
    assert "off-line" in advice


def test_an_export_that_knows_its_dead_time_does_not_look_for_it(tmp_path: Path) -> None:
    from pmfid.export.firmware import export_firmware

    for late, looks in ((0.02, 0), ("estimate", 1)):
        folder = tmp_path / str(looks)
        export_firmware(RIV(Drive(2.0, dead_time=late), Encoder(1e-4), 0.01, 20.0), folder)
        assert f"#define PMF_WITH_DEAD_TIME_FOUND {looks}" in (folder / "pmf_sizes.h").read_text()


def test_crafted_states_are_refused_or_do_no_harm() -> None:
    """For any content of the new part of a state, the output is a number, and the dead time is within its range."""
    run, step = moved("carriage", 0.6), AXES["carriage"][1]
    estimator = RIV(Drive(2.0, dead_time="estimate"), Encoder(step), 0.01, 20.0)
    estimator.run(run.u[:900], run.counts[:900])
    raw, layout = estimator.runner.kernel.raw_state(), structures(None, "float64")["pmf_state_t"]
    rng, taken = np.random.default_rng(4), 0
    values = [np.nan, np.inf, -1.0, 0.0, 3.0, 1e7, 1e-300, 1e300]
    for _ in range(150):
        state = np.frombuffer(bytearray(raw), layout)
        part = state["found"][str(rng.choice(["theta", "covariance", "place", "velocity", "expected", "age", "tries"]))]
        number = rng.choice(values)
        whole = part.dtype.kind in "ui"
        part.reshape(-1)[rng.integers(part.size)] = 4_000_000_000 if whole else number
        runner = estimator.start()
        try:
            runner.kernel.set_raw_state(state.tobytes())
        except ValueError:
            continue
        taken += 1
        track = runner.run(run.u[900:1100], run.counts[900:1100])
        assert np.isfinite(track.theta).all()
        assert np.all((track.theta[:, 3] >= 0) & (track.theta[:, 3] <= 0.21))
    assert 20 < taken < 130
