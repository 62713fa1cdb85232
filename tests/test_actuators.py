"""Servos under position commands: simulation against small steps, parameters against the truth, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmfid._body import BASE, KINDS, run
from pmfid.actuators import JointLog, Servo, ServoFit, fit_logs, fit_servo, simulate_servo
from pmfid.actuators.search import ServoSearch, ServoTask
from pmfid.errors import NotIdentifiableError
from pmfid.fit.search import errors_of
from pmfid.types import Floats
from studies.servo_truth import TrueServo, simulate_servos
from tests.conftest import long_unless
from tests.refusals import refused

STEP = 2 * math.pi / 4096
#: inertia, viscous, coulomb, kp, kd, gravity, torque_limit, delay of a servo on a pendulum.
TRUTH = {"inertia": 0.01, "viscous": 0.06, "coulomb": 0.05, "kp": 8.0, "kd": 0.02, "gravity": 1.3, "delay": 0.01}
TRUTH |= {"torque_limit": 1e9, "stop": 1e9}


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
        for _ in range(inner):
            v += h / truth["inertia"] * (torque - truth["gravity"] * math.sin(x) - truth["viscous"] * v)
            stop = h / truth["inertia"] * truth["coulomb"]
            v = v - math.copysign(stop, v) if abs(v) > stop else 0.0
            x += h * v
            x, v = (x, v) if abs(x) < truth["stop"] else (math.copysign(truth["stop"], x), 0.0)
    return out


def make_log(
    seed: int = 1, time: float = 8.0, period: float = 0.01, step: float = STEP, **changes: float
) -> tuple[Floats, Floats, Floats]:
    """Times, goals and positions in whole steps of a servo under steps and sines."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, time, period)
    steps = rng.uniform(-0.5, 0.5, t.size // 40 + 1).repeat(40)[: t.size]
    goal = np.where(t < time / 2, steps, 0.4 * np.sin(5 * t) + 0.2 * np.sin(13 * t))
    position = simulate_by_small_steps({**TRUTH, **changes}, np.append(t, time), np.append(goal, goal[-1]), step)
    return t, goal, step * np.floor(position[:: round(period / 1e-3)] / step + 0.5)


def test_derivatives_are_those_of_the_simulated_motion() -> None:
    """Central differences are the oracle, apart from the discontinuous times of stops."""
    rng, t = np.random.default_rng(3), np.cumsum(np.random.default_rng(4).uniform(0.008, 0.012, 301))
    goal = np.where(t < 1.5, rng.uniform(-0.7, 0.7, 301).repeat(20)[:301], 0.4 * np.sin(5 * t) + 0.15 * np.sin(13 * t))
    names = ["wave", "stribeck", "load", "load_stribeck", "loop_filtered", "loop_integral"]
    constants = {"wave": 2 * math.pi, "stribeck": 0.5, "load_stribeck": 0.4, "loop_filtered": 4e-3}
    free = {"stribeck", "load_stribeck", "loop_filtered"}
    forces = [(KINDS[name], 0, name in free, np.zeros(1), constants.get(name, 0.0), 0.0, False) for name in names]
    forces += [(KINDS[name], 0, False, np.zeros(1), 0.0, 1.0, False) for name in ("load", "column_viscous", "slope")]
    base = [0.01, 0.15, 0.1, 0.1, 0.01, 0.0137, 0.0, 0.1, 0.2]
    values = np.array([*base, 1.0, 0.08, 0.1, 0.05, 0.06, 3.0, 0.1, 0.04, 0.2, 0.5, 0.4, 4e-3, 9.0, 2.0, 2.3e-3])
    rows, columns = np.arange(301, dtype=np.int32), np.ones((1, 300))

    def move(theta: Floats, slopes: bool = False) -> tuple[Floats, Floats]:
        lift = np.eye(theta.size) if slopes else None
        y, _, S, _ = run(forces, np.diff(t), goal[:-1].copy(), rows, columns, theta, 1, lift, 2e-4)
        return y, S

    moved, slopes = move(values, slopes=True)
    assert (moved == move(values)[0]).all()
    assert len(base) == BASE
    for column in np.flatnonzero(values != 0).tolist():
        size = 1e-6 * np.abs(values) * (np.arange(values.size) == column)
        expected = (move(values + size)[0] - move(values - size)[0]) / (2 * size[column])
        assert np.quantile(np.abs(slopes[:, column] - expected), 0.9) < 2e-3 * np.std(expected), column


def test_a_controller_that_is_off_moves_nothing() -> None:
    theta = np.array([0.01, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 1e9, 1e-3])
    step, rows = np.full(50, 0.01), np.arange(51, dtype=np.int32)
    y, _, _, _ = run([], step, np.ones(50), rows, np.zeros((0, 50)), theta, 1, None, 1e-3, np.repeat([0.0, 1.0], 25))
    assert not y[:26].any()
    assert y[-1] > 0.5


def check_estimates(fit: ServoFit, within: float, **changes: float) -> None:
    truth = {**TRUTH, **changes}
    for name, value, std in zip(fit.raw_names, fit.theta, fit.theta_std, strict=True):
        if truth.get(name) and name not in ("viscous", "kd"):  # their sum is what positions show
            assert abs(value - truth[name]) < within * truth[name] + 2 * std, name
            assert abs(value - truth[name]) < 4 * std, name


DRAG = {"back_emf": 0.1, "torque_limit": 1.5, "gravity": 1.3}
FALLING = {"torque_limit": 1.5, "no_load": 15.0}


@pytest.mark.parametrize(
    "more",
    long_unless(lambda more: "motor_friction" in more, [{}, {"load_friction": 0.2}, {**DRAG, "motor_friction": 0.3}]),
)
def test_the_simulated_loop_is_that_of_small_steps(more: dict[str, float]) -> None:
    t = np.arange(0.0, 1.2, 0.01)
    goal = 0.5 * np.sign(np.sin(3 * t)) + 0.2 * np.sin(11 * t)
    true = TrueServo(0.01, 0.06, 0.05, 8.0, 0.01, 1e-6, **more)
    given = {"inertia": 0.01, "viscous": 0.06, "coulomb": 0.05, "kp": 8.0, "delay": 0.01, "gravity_angle": 0.0, **more}
    found = simulate_servo(Servo(STEP, given), np.empty(0), t, goal, 0.0)
    assert np.abs(found - simulate_servos([true], [t], [goal])[0]).max() < 0.3 * STEP


def test_a_servo_with_a_known_gain_shows_inertia_friction_gravity_and_delay() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}, terms=["gravity"]), *make_log())
    assert fit.raw_names[:5] == ("inertia", "viscous", "coulomb", "delay", "gravity")
    check_estimates(fit, 0.02)
    assert fit.status == ()
    assert fit.residual < 1.2 * STEP / math.sqrt(12)


def test_a_known_force_gives_the_gain() -> None:
    t, goal, position = make_log(seed=2, kd=0.0)
    force = TRUTH["gravity"] * np.sin(position)
    fit = fit_servo(Servo(STEP, given={"kd": 0.0}), t, goal, position, force=force, search=False)
    assert fit.raw_names == ("inertia", "viscous", "coulomb", "kp", "delay")
    for name, value in zip(fit.raw_names, fit.theta.tolist(), strict=True):  # the force has errors of its own
        assert value == pytest.approx(TRUTH[name], rel=0.02), name
    refused(("the known force is zero", lambda: fit_servo(Servo(STEP), t, goal, position, force=0 * force)))


@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.long)])
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
    return t, goal, simulate_servos([true], [t], [goal])[0]


@pytest.mark.long
@pytest.mark.parametrize("law", [{"deadzone": 0.02}, {"backlash": 2 * STEP}])
def test_a_law_that_no_term_has_is_doubted(law: dict[str, float]) -> None:
    """The motion deviates by half a count. With an empty status, the frictions were 6 and 12 bars off."""
    fit = fit_servo(Servo(STEP, {"kp": 8.0}), *simulate_law(2, **law))
    assert "unmodelled" in fit.status


@pytest.mark.parametrize("law", long_unless(lambda law: law == FALLING, [{"load_friction": 0.1}, {}, FALLING]))
def test_bars_hold_what_load_friction_or_a_limit_that_falls_with_the_speed_hides(law: dict[str, float]) -> None:
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), *simulate_law(3, **law))
    assert {"limit_slope", "back_emf"} & {*fit.added} == ({"limit_slope"} if law == FALLING else set())
    for name, truth in (("inertia", 0.01), ("viscous", 0.2), ("coulomb", 0.05)):
        place = fit.raw_names.index(name)
        assert abs(fit.theta[place] - truth) < 3 * fit.theta_std[place], name


def test_a_log_that_polls_has_early_goals_and_inexact_stamps() -> None:
    rng = np.random.default_rng(4)
    sent = np.cumsum(np.r_[0.0, rng.uniform(0.017, 0.023, 399)])
    goal = 0.4 * np.sign(np.sin(3 * sent)) + 0.2 * np.sin(13 * sent)
    read, stamped = sent + rng.uniform(0.006, 0.01, 400), sent + rng.uniform(0.013, 0.015, 400)
    law = {**TRUTH, "viscous": 0.2, "delay": 0.002, "kd": 0.0, "gravity": 0.0}
    motion = simulate_by_small_steps(law, np.append(sent, 8.1), np.append(goal, goal[-1]), inner=40)
    position = STEP * np.rint(np.interp(read, 1e-3 * np.arange(motion.size), motion) / STEP)
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), stamped, goal, position)
    assert {"early_goals", "stamps"} <= {finding.code for finding in fit.findings}
    check_estimates(fit, 0.02, delay=0.0025 - 0.008)
    assert fit.theta_std[0] < 0.05 * fit.theta[0]


@pytest.mark.parametrize(("code", "late", "stop"), [("early_goals", 3, 1e9), ("stops", 0, 0.2)])
def test_stamps_of_later_rows_and_stops_leave_the_values_right(code: str, late: int, stop: float) -> None:
    t, goal, position = make_log(kd=0.0, gravity=0.0, stop=stop)
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0}), t[late:], goal[: t.size - late], position[late:])
    check_estimates(fit, 0.01, delay=0.01 * (1 - late))
    assert code in {finding.code for finding in fit.findings}


def test_half_of_the_friction_may_move_into_the_loop() -> None:
    """Slow motion stays as it was, because the inertia holds the friction of the loop times its lag."""
    servo, (t, goal, _) = Servo(STEP, {"kp": 8.0}), make_log()
    y = simulate_servo(servo, np.array([0.01, 0.2, 0.05, 0.01]), t, goal, 0.0)
    task = ServoTask(servo, [JointLog("joint", t, goal, y, STEP)], (), 1)
    problem = task.problem()
    q = problem.start(np.array([0.01, 0.2, 0.05, 0.01 + task.lead, 0.0]))
    search = ServoSearch(task, problem, q, problem.first_starts(), True)
    search.set_lag(4e-3, half=True)
    moved = np.std(errors_of(search)[0])
    assert search.q[1] == pytest.approx(0.1, rel=0.02)
    search.q[0] = q[0]
    assert moved < 0.3 * np.std(errors_of(search)[0])


def test_logs_of_one_servo_share_their_parameters() -> None:
    servo, logs = Servo(STEP, {"gravity": 1.3, "gravity_angle": 0.0, "kd": 0.0}), []
    for seed, gain in ((1, 8.0), (2, 16.0)):
        logs.append(JointLog("joint", *make_log(seed=seed, kp=gain, kd=0.0, time=6.0), STEP))
    fit = fit_logs(servo, logs, ["kp"], search=False)
    assert fit.theta[0] == pytest.approx(0.01, rel=0.01)
    one = fit_logs(servo, logs[:1], search=False)
    assert np.all(fit.theta_std[1:3] < np.array([0.1, 1.0]) * one.theta_std[1:3])
    refused(("gravity cannot differ by log", lambda: fit_logs(servo, logs, ["gravity"])))


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
