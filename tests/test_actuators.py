"""Servos under position commands: simulation against small steps, parameters against the truth, refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid._body import BASE, KINDS, run
from pmfid.actuators import JointLog, Servo, ServoFit, fit_logs, fit_servo, simulate_servo
from pmfid.actuators.body import body_of, excite
from pmfid.actuators.bounded import cut_below
from pmfid.actuators.logs import LogLayout, read_joints
from pmfid.actuators.ticks import run_ticks, split_loop
from pmfid.actuators.tuning import ActuatorTuning
from pmfid.errors import NotIdentifiableError
from pmfid.fit.machine import simulate
from pmfid.fit.problem import ObservedStretch
from pmfid.types import Floats
from studies.servo_grid import draw_case, draw_goal
from studies.servo_truth import TrueServo, simulate_servos
from tests.refusals import refused

STEP = 2 * math.pi / 4096
ROBOTS = Path(__file__).parents[2] / "shared" / "data" / "robots"
#: inertia, viscous, coulomb, kp, kd, gravity, torque_limit, delay of a servo on a pendulum.
TRUTH = {"inertia": 0.01, "viscous": 0.06, "coulomb": 0.05, "kp": 8.0, "kd": 0.02, "gravity": 1.3, "delay": 0.01}
TRUTH |= {"torque_limit": 1e9, "off": 1e9}


def simulate_by_small_steps(
    truth: dict[str, float], t: Floats, goal: Floats, resolution: float = STEP, inner: int = 10
) -> Floats:
    """Position (n,) on a grid of 1 ms: semi-implicit Euler, loop at 1 kHz on counts."""
    h, x, v, torque, before = 1e-3 / inner, 0.0, 0.0, 0.0, 0.0
    ticks = round((t[-1] - t[0]) / 1e-3)
    held = goal[np.searchsorted(t, np.arange(ticks) * 1e-3 + 1e-9 - truth["delay"], side="right") - 1]
    held[: round(truth["delay"] / 1e-3)] = goal[0]
    out = np.empty(ticks)
    for k in range(ticks):
        out[k] = x
        y = resolution * round(x / resolution) if resolution else x
        torque = truth["kp"] * (held[k] - y) - truth["kd"] * (y - before) / 1e-3
        torque, before = max(-truth["torque_limit"], min(torque, truth["torque_limit"])), y
        torque *= k * 1e-3 < truth["off"]
        for _ in range(inner):
            v += h / truth["inertia"] * (torque - truth["gravity"] * math.sin(x) - truth["viscous"] * v)
            stop = h / truth["inertia"] * truth["coulomb"]
            v = v - math.copysign(stop, v) if abs(v) > stop else 0.0
            x += h * v
    return out


def make_log(
    seed: int = 1, time: float = 8.0, period: float = 0.01, step: float = STEP, **changes: float
) -> tuple[Floats, Floats, Floats]:
    """Times, goals and positions in whole steps of a servo under steps and sines."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, time, period)
    steps = rng.uniform(-0.5, 0.5, t.size // 40 + 1).repeat(40)[: t.size]
    goal = np.where(t < time / 2, steps, 0.4 * np.sin(5 * t) + 0.2 * np.sin(13 * t))
    position = simulate_by_small_steps({**TRUTH, **changes}, np.append(t, time), np.append(goal, goal[-1]), step)
    every = round(period / 1e-3)
    return t, goal, step * np.floor(position[::every] / step + 0.5)


@pytest.fixture(autouse=True)
def _few_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The landscape of these logs is plain, and the tests are to be quick."""
    monkeypatch.setattr(ActuatorTuning, "draws", 150)
    monkeypatch.setattr(ActuatorTuning, "refined", 3)


def test_derivatives_are_those_of_the_simulated_motion() -> None:
    """Central differences are the oracle, apart from the discontinuous times of stops."""
    rng, t = np.random.default_rng(3), np.cumsum(np.random.default_rng(4).uniform(0.008, 0.012, 301))
    goal = np.where(t < 1.5, rng.uniform(-0.7, 0.7, 301).repeat(20)[:301], 0.4 * np.sin(5 * t) + 0.15 * np.sin(13 * t))
    names = ["wave", "stribeck", "load", "load_stribeck", "loop_velocity", "loop_filtered", "loop_integral"]
    constants = {"wave": 2 * math.pi, "stribeck": 0.5, "load_stribeck": 0.4, "loop_filtered": 4e-3}
    free = {"stribeck", "load_stribeck", "loop_filtered"}
    forces = [(KINDS[name], 0, name in free, np.zeros(1), constants.get(name, 0.0), 0.0, False) for name in names]
    forces += [(KINDS[name], 0, False, np.zeros(1), 0.0, 1.0, False) for name in ("load", "column_viscous")]
    base = [0.01, 0.15, 0.1, 0.1, 0.01, 0.0137, 0.0, 0.1, 0.2]
    values = np.array([*base, 1.0, 0.08, 0.1, 0.05, 0.05, 0.06, 3.0, 0.1, 0.04, 0.5, 0.4, 4e-3, 9.0, 3.0, 2.3e-3])
    rows, columns = np.arange(301, dtype=np.int32), np.ones((1, 300))

    def move(theta: Floats, slopes: bool = False) -> tuple[Floats, Floats]:
        y, _, S, _ = run(forces, np.diff(t), goal[:-1].copy(), rows, columns, theta, 1, slopes, 2e-4)
        return y, S

    moved, slopes = move(values, slopes=True)
    assert (moved == move(values)[0]).all()
    assert len(base) == BASE
    for column in np.flatnonzero(values != 0).tolist():
        size = 1e-6 * np.abs(values) * (np.arange(values.size) == column)
        expected = (move(values + size)[0] - move(values - size)[0]) / (2 * size[column])
        worst = np.quantile(np.abs(slopes[:, column] - expected), 0.9)
        assert worst < 2e-3 * np.std(expected), column


def test_a_controller_that_is_off_moves_nothing() -> None:
    theta = np.array([0.01, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 1e9, 1e-3])
    step, rows = np.full(50, 0.01), np.arange(51, dtype=np.int32)
    on = np.r_[np.zeros(25), np.ones(25)]
    y, _, _, _ = run([], step, np.ones(50), rows, np.zeros((0, 50)), theta, 1, False, 1e-3, on)
    assert not y[:26].any()
    assert y[-1] > 0.5


def check_estimates(fit: ServoFit, within: float, **changes: float) -> None:
    truth = {**TRUTH, **changes}
    for name, value, std in zip(fit.raw_names, fit.theta, fit.theta_std, strict=True):
        if truth.get(name) and name not in ("viscous", "kd"):  # their sum is what positions show
            assert abs(value - truth[name]) < within * truth[name] + 2 * std, name
            assert abs(value - truth[name]) < 4 * std, name


DRAG = {"back_emf": 0.1, "torque_limit": 1.5, "gravity": 1.3}


@pytest.mark.parametrize("more", [{}, {"load_friction": 0.2}, {**DRAG, "motor_friction": 0.3}, {"gravity": 1.3}])
def test_the_simulated_loop_is_that_of_small_steps(more: dict[str, float]) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    goal = 0.5 * np.sign(np.sin(3 * t)) + 0.2 * np.sin(11 * t)
    true = TrueServo(0.01, 0.06, 0.05, 8.0, 0.01, 1e-6, **more)
    given = {"inertia": 0.01, "viscous": 0.06, "coulomb": 0.05, "kp": 8.0, "delay": 0.01, "gravity_angle": 0.0, **more}
    found = simulate_servo(Servo(STEP, given), np.empty(0), t, goal, 0.0)
    assert np.abs(found - simulate_servos([true], t, [goal])[0]).max() < 0.3 * STEP


def test_a_servo_with_a_known_gain_shows_inertia_friction_gravity_and_delay() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}, terms=["gravity"]), *make_log())
    assert fit.raw_names[:5] == ("inertia", "viscous", "coulomb", "delay", "gravity")
    check_estimates(fit, 0.02)
    assert fit.status == ()
    assert fit.residual < 1.2 * STEP / math.sqrt(12)


def test_known_gravity_gives_the_gain_at_an_unknown_angle() -> None:
    fit = fit_servo(Servo(STEP, given={"gravity": 1.3, "kd": 0.02}), *make_log(seed=2), search=False)
    check_estimates(fit, 0.02)
    assert abs(fit.theta[fit.raw_names.index("gravity_angle")]) < 0.01
    assert fit.theta[fit.raw_names.index("kp")] == pytest.approx(8.0, rel=0.02)


def test_a_known_force_gives_the_gain() -> None:
    t, goal, position = make_log(seed=2, kd=0.0)
    force = TRUTH["gravity"] * np.sin(position)
    fit = fit_servo(Servo(STEP, given={"kd": 0.0}), t, goal, position, force=force, search=False)
    assert fit.raw_names == ("inertia", "viscous", "coulomb", "kp", "delay")
    for name, value in zip(fit.raw_names, fit.theta.tolist(), strict=True):  # the force has errors of its own
        assert value == pytest.approx(TRUTH[name], rel=0.01), name
    refused(("the known force is zero", lambda: fit_servo(Servo(STEP), t, goal, position, force=0 * force)))


@pytest.mark.parametrize("slow", [False, True])
def test_friction_by_the_motors_torque_and_a_limit_by_the_voltage_are_found(slow: bool) -> None:
    known = {"inertia": 0.0172, "viscous": 0.03, "coulomb": 0.02, "kp": 14.0, "delay": 0.004, "torque_limit": 4.0}
    known |= {"gravity": 1.47, "gravity_angle": 0.0, "back_emf": 0.5, "motor_friction": 0.3, "motor_stribeck": 0.15}
    t = np.arange(0.0, 6.0, 0.012)
    goal = 0.8 - 0.8 * np.cos(t) if slow else np.sin(t**2)
    y = simulate_servo(Servo(STEP, {**known, "motor_stribeck_speed": 2.0}), np.empty(0), t, goal, 0.0)
    log = JointLog("joint", t, goal, STEP * np.rint(y / STEP), STEP, stated={"pendulum": 0.0122})
    fit = fit_logs(Servo(STEP, {"gravity": 1.47}), [log])
    assert abs(fit.theta[0] - 0.0172) < min(3 * fit.theta_std[0], (0.5 if slow else 0.05) * 0.0172)
    assert "motor_friction" in fit.added or slow


def test_without_any_torque_all_torques_are_multiples_of_the_gain() -> None:
    fit = fit_servo(Servo(STEP, given={"kd": 0.0}), *make_log(seed=3, gravity=0.0, kd=0.0), search=False)
    assert fit.names[:3] == ("inertia/kp", "viscous/kp", "coulomb/kp")
    assert fit.units[:3] == ("s2", "s", "rad")
    assert fit.theta[0] == pytest.approx(0.01 / 8.0, rel=0.01)
    assert "relative" in [finding.code for finding in fit.findings]


def test_a_limit_that_the_model_lacks_is_found() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *make_log(seed=4, gravity=0.0, torque_limit=1.5))
    assert "torque_limit" in fit.added
    assert 0.02 < fit.limited < 0.6
    check_estimates(fit, 0.02, torque_limit=1.5)


def test_gravity_that_the_model_lacks_is_found() -> None:
    log = make_log(seed=5)
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *log)
    assert "gravity" in fit.added
    check_estimates(fit, 0.02)
    plain = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *log, search=False)
    assert "unmodelled" in plain.status


def simulate_law(seed: int, rate: int = 100, **law: float) -> tuple[Floats, Floats, Floats]:
    """Log of a servo of `studies.servo_truth` with a control law."""
    t, rng = np.arange(0.0, 8.0, 1 / rate), np.random.default_rng(seed)
    steps = rng.uniform(-0.5, 0.5, 21)[(t / 0.4).astype(int)]
    goal = np.where(t < 4, steps, 0.4 * np.sin(5 * t) + 0.2 * np.sin(13 * t))
    true = TrueServo(0.01, 0.2, 0.05, 8.0, 0.01, STEP, **law)
    return t, goal, simulate_servos([true], t, [goal])[0]


def test_an_integral_gain_is_found_within_five_percent() -> None:
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), *simulate_law(1, ki=24.0))
    assert "ki" in fit.added
    assert fit.theta[fit.raw_names.index("ki")] == pytest.approx(24.0, rel=0.05)


def test_the_inertia_of_a_servo_with_a_filtered_velocity_is_within_its_bar() -> None:
    """Without the filter the inertia would be the gain times its lag too small, 6 %."""
    fit = fit_servo(Servo(STEP, {"kp": 8.0}), *simulate_law(2, kd_filtered=0.15, velocity_filter=3e-3))
    assert abs(fit.theta[0] - 0.01) < 3 * fit.theta_std[0]
    assert fit.theta_std[0] < 0.1 * 0.01


def test_counts_in_a_derivative_gain_do_not_loosen_the_friction_of_the_table() -> None:
    """Each count is a pulse of torque of twice the Coulomb friction. Without the ticks, kp was 16 % low, 4 bars."""
    t, rng = np.arange(0.0, 8.0, 0.01), np.random.default_rng(3)
    goal = np.where(t < 4, rng.uniform(-0.7, 0.7, 21)[(t / 0.4).astype(int)], 0.4 * np.sin(5 * t))
    truth = TrueServo(2e-3, 0.026, 0.035, 1.5, 0.009, 2 * math.pi / 1024, kd=0.0175, ki=4.5, gravity=0.1)
    truth = replace(truth, load_friction=0.13)
    position = simulate_servos([truth], t, [goal])[0]
    fit = fit_servo(Servo(truth.resolution, {"gravity": 0.1}), t, goal, position)
    for name in ("inertia", "coulomb", "kp", "ki", "load_friction"):
        place = fit.raw_names.index(name)
        assert abs(fit.theta[place] - getattr(truth, name)) < 3 * fit.theta_std[place], name
        assert fit.theta_std[place] < 0.2 * fit.theta[place], name


def test_the_period_of_a_cogging_longer_than_the_travel_is_uncertain() -> None:
    """With the period of the scan, the gain was 3 % high, 16 bars."""
    t, case = np.arange(0.0, 10.0, 0.002), draw_case(16, 41, wrong=False)
    goal = draw_goal(t, np.random.default_rng([16, 41, 53, 0]))
    fit = fit_servo(case.servo, t, goal, simulate_servos([case.truth], t, [goal])[0])
    place = fit.raw_names.index("kp")
    assert abs(fit.theta[place] - case.truth.kp) < 3 * fit.theta_std[place]
    assert fit.theta_std[place] < 0.03 * case.truth.kp


def test_a_known_load_and_a_cogging_joint_have_starts_of_their_own() -> None:
    """The first one ended in a gain of 239 % with a bar of 8 %, the second one in gravity and Stribeck friction."""
    t, numbers = np.arange(0.0, 10.0, 0.005), (25, 38)
    cases = [draw_case(number, 31, wrong=False) for number in numbers]
    goals = [draw_goal(t, np.random.default_rng([number, 31, 53, 0])) for number in numbers]
    positions = simulate_servos([case.truth for case in cases], t, goals)
    load, cogging = (fit_servo(case.servo, t, goal, y) for case, goal, y in zip(cases, goals, positions, strict=True))
    assert load.theta[load.raw_names.index("kp")] == pytest.approx(cases[0].truth.kp, rel=0.02)
    assert cogging.theta[0] == pytest.approx(cases[1].truth.inertia, rel=0.01)
    assert "cogging" in cogging.added
    assert load.status == cogging.status == ()


@pytest.mark.parametrize("law", [{"deadzone": 0.02}, {"backlash": 2 * STEP}])
def test_a_law_that_no_term_has_is_doubted(law: dict[str, float]) -> None:
    """The motion deviates by half a count. With an empty status, the frictions were 6 and 12 bars off."""
    fit = fit_servo(Servo(STEP, {"kp": 8.0}), *simulate_law(2, **law))
    assert "unmodelled" in fit.status


def test_ticks_of_a_fine_encoder_leave_the_motion_of_the_body() -> None:
    t = np.arange(200) * 0.01
    goal = 0.5 * np.sign(np.sin(4 * t))
    servo = Servo(1e-7, {"kp": 8.0, "kd": 0.0, "inertia": 0.01, "viscous": 0.3, "coulomb": 0.05, "delay": 0.012})
    body = body_of(servo)
    drive = excite(t, goal, 1e-3)
    flags = np.ones(t.size, bool)
    stretch = ObservedStretch(drive, goal, np.ones(t.size), flags, ~flags)
    smooth, _, _ = simulate(drive, body.forces, body.rest, 2, slopes=False)
    ticked = run_ticks(stretch, split_loop(body.rest, body.forces), 1e-3, 1e-7, 2)
    assert np.max(np.abs(ticked - smooth)) < 1e-3
    assert np.max(np.abs(smooth)) > 0.4


def test_a_normal_distribution_without_its_negative_part() -> None:
    mean, covariance = np.array([-0.3, 1.0]), np.array([[1.0, -0.6], [-0.6, 1.0]])
    drawn = np.random.default_rng(0).multivariate_normal(mean, covariance, 400_000)
    kept = drawn[drawn[:, 0] > 0]
    value, centre, inner = cut_below(mean, covariance, np.array([0.0, -np.inf]))
    assert value == pytest.approx(math.log(len(kept) / len(drawn)), abs=0.01)
    assert centre == pytest.approx(kept.mean(axis=0), abs=0.01)
    assert inner == pytest.approx(np.cov(kept.T), abs=0.01)


def test_friction_that_grows_with_the_root_of_the_speed_is_no_coulomb_friction() -> None:
    """Without the term, the Coulomb friction was 63 % high, 29 bars, with an empty status."""
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), *simulate_law(2, root=0.05))
    assert "root_friction" in fit.added
    for name, truth in (("inertia", 0.01), ("viscous", 0.2), ("coulomb", 0.05)):
        place = fit.raw_names.index(name)
        assert abs(fit.theta[place] - truth) < 3 * fit.theta_std[place], name
        assert fit.theta_std[place] < 0.3 * truth, name


def test_four_logs_of_a_motor_in_one_call() -> None:
    """The published inertia is 0.0251 kg m2, of the motor and its pendulum."""
    paths = sorted(ROBOTS.glob("bam_feetech*.json"))
    if not paths:
        pytest.skip("the shared logs of robots are absent")
    logs = [log for path in paths for log in read_joints(path, LogLayout())]
    fit = fit_logs(Servo(logs[0].resolution, logs[0].given), logs)
    assert fit.theta[0] == pytest.approx(0.0251, rel=0.02)
    assert fit.theta_std[0] < 0.02 * 0.0251


@pytest.mark.parametrize("friction", [0.1, 0.0])
def test_a_damped_joint_has_bars_that_hold_its_load_friction(friction: float) -> None:
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), *simulate_law(3, load_friction=friction))
    for name, truth in (("inertia", 0.01), ("viscous", 0.2), ("coulomb", 0.05)):
        place = fit.raw_names.index(name)
        assert abs(fit.theta[place] - truth) < 3 * fit.theta_std[place], name


def test_logs_of_one_servo_share_their_parameters() -> None:
    servo, logs = Servo(STEP, {"gravity": 1.3, "gravity_angle": 0.0, "kd": 0.0}), []
    for seed, gain in ((1, 8.0), (2, 16.0)):
        logs.append(JointLog("joint", *make_log(seed=seed, kp=gain, kd=0.0, time=6.0), STEP))
    fit = fit_logs(servo, logs, ["kp"], search=False)
    assert fit.theta[0] == pytest.approx(0.01, rel=0.01)
    for name, gain in (("kp.1", 8.0), ("kp.2", 16.0)):
        assert fit.theta[fit.raw_names.index(name)] == pytest.approx(gain, rel=0.01)
    one = fit_logs(servo, logs[:1], search=False)
    assert fit.theta_std[2] < 0.9 * one.theta_std[2]
    refused(("gravity cannot differ by log", lambda: fit_logs(servo, logs, ["gravity"])))


def test_rows_with_the_torque_off_are_a_free_motion() -> None:
    """The swing shows inertia, friction and gravity alone, so that the gain is known by the gravity."""
    t, goal, position = make_log(seed=1, kd=0.0, off=5.0 + TRUTH["delay"])  # as late as a goal
    on = (t < 5.0).astype(float)
    servo = Servo(STEP, {"kd": 0.0, "gravity": 1.3, "gravity_angle": 0.0})
    fit = fit_servo(servo, t, goal, position, on=on, search=False)
    assert fit.theta[0] == pytest.approx(0.01, rel=0.005)
    assert fit.theta_std[0] < 0.01 * 0.01
    assert fit.theta[fit.raw_names.index("viscous")] == pytest.approx(0.06, rel=0.02)
    assert fit.theta[fit.raw_names.index("kp")] == pytest.approx(8.0, rel=0.02)
    assert abs(fit.theta[fit.raw_names.index("back_emf")]) < 3 * fit.theta_std[fit.raw_names.index("back_emf")] + 1e-9


def test_only_the_first_part_of_a_long_log_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ActuatorTuning, "longest", 4.0)
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), *make_log(seed=3, gravity=0.0, kd=0.0), search=False)
    assert fit.simulated[0].size == 401
    assert any("first 4 s" in finding.sentence for finding in fit.findings)


def test_rows_may_be_missing() -> None:
    t, goal, position = make_log(seed=6, gravity=0.0)
    keep = np.random.default_rng(0).random(t.size) > 0.1
    keep |= np.append(False, np.diff(goal) != 0)  # a command that nobody logged cannot be simulated
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), t[keep], goal[keep], position[keep], search=False)
    check_estimates(fit, 0.2, gravity=0.0)


def test_arrays_that_no_fit_can_use_are_refused() -> None:
    t, servo = np.arange(200) * 0.01, Servo(STEP)
    y: Floats = np.sin(t)
    refused(
        ("equally long", lambda: fit_servo(servo, t, y[:-1], y)),
        ("too few", lambda: fit_servo(servo, t[:30], y[:30], y[:30])),
        ("goal is not finite in row 0", lambda: fit_servo(servo, t, np.where(t < 1, np.nan, y), y)),
        ("does not rise after row 0", lambda: fit_servo(servo, t[::-1], y, y)),
    )


def test_a_motion_that_does_not_follow_the_command_is_refused() -> None:
    t, goal, position = make_log()
    refused(
        ("the same joint", lambda: fit_servo(Servo(STEP), t, np.random.default_rng(0).permutation(goal), -position)),
        ("hardly moves", lambda: fit_servo(Servo(STEP), t, goal, 0 * position)),
        kind=NotIdentifiableError,
    )


def test_a_servo_of_impossible_values_is_refused() -> None:
    refused(
        ("resolution must be positive", lambda: Servo(0.0)),
        ("did you mean 'kp'", lambda: Servo(STEP, {"kq": 1.0})),
        ("kp must be finite and positive", lambda: Servo(STEP, {"kp": -1.0})),
        ("unknown parameter 'friction'", lambda: Servo(STEP, terms=["friction"])),
    )


def test_a_position_that_scatters_by_more_than_rounding_is_flagged() -> None:
    t, goal, position = make_log(seed=7, gravity=0.0)
    scatter = STEP * np.random.default_rng(7).integers(-2, 3, t.size)
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), t, goal, position + scatter, search=False)
    assert fit.status == ("unmodelled",)
    check_estimates(fit, 0.05, gravity=0.0)


def test_a_friction_may_rise_with_the_speed() -> None:
    servo = Servo(STEP, {"kp": 8.0, "stribeck": -0.01, "stribeck_speed": 1.0})
    t = np.arange(0.0, 1.0, 0.01)
    slow = simulate_servo(servo, np.array([0.01, 0.06, 0.05, 0.01]), t, t, 0.0)
    plain = simulate_servo(replace(servo, given={"kp": 8.0}), np.array([0.01, 0.06, 0.05, 0.01]), t, t, 0.0)
    assert slow[-1] > plain[-1]
    refused(("load_friction must be", lambda: Servo(STEP, {"load_friction": -0.1})))
