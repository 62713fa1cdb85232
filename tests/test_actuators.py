"""Servos under position commands: simulation against small steps, parameters against the truth, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pmfid.actuators import Servo, fit_servo
from pmfid.actuators.rounding import compute_cost, compute_score, compute_weight, invert_curvature
from pmfid.actuators.tuning import ActuatorTuning
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.simulation._servo import simulate_servo
from pmfid.types import Floats
from studies.servo_truth import TrueServo, simulate_servos

STEP = 2 * math.pi / 4096
#: inertia, viscous, coulomb, kp, kd, gravity, torque_limit, delay of a servo on a pendulum.
TRUTH = {"inertia": 0.01, "viscous": 0.06, "coulomb": 0.05, "kp": 8.0, "kd": 0.02, "gravity": 1.3, "delay": 0.01}
TRUTH["torque_limit"] = 1e9


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
    monkeypatch.setattr(ActuatorTuning, "rounds", ((300, 3),))


def test_derivatives_are_those_of_the_simulated_motion() -> None:
    """Central differences are the oracle, apart from samples at which a shifted command moves over a tick."""
    rng, t = np.random.default_rng(3), np.cumsum(np.random.default_rng(4).uniform(0.008, 0.012, 500))
    goal = np.where(t < 2.5, rng.uniform(-0.7, 0.7, 25).repeat(20), 0.4 * np.sin(5 * t) + 0.15 * np.sin(13 * t))
    given = {"inertia": 0.01, "viscous": 0.15, "coulomb": 0.1, "kp": 9.0, "kd": 0.1, "torque_limit": 3.0}
    given |= {"delay": 0.0137, "loop_delay": 2.3e-3, "gravity": 1.0, "gravity_angle": 0.3, "offset": 0.1}
    given |= {"stribeck": 0.08, "stribeck_speed": 0.5, "load_friction": 0.1, "quadratic": 0.003}
    servo = Servo(STEP, terms=list(given)[4:], known_force=True)
    values, force = np.array([given[name] for name in servo.unknown]), 0.4 * np.sin(3 * t)

    def move(own: Floats) -> Floats:
        return servo.simulate(own[:-2], t, goal, float(own[-2]), float(own[-1]), force=force)

    own = np.append(values, [0.1, 0.2])
    moved, slopes = servo.differentiate(values, t, goal, 0.1, 0.2, force)
    assert (moved == move(own)).all()
    assert slopes.shape == (500, 17)
    for column, size in enumerate(1e-6 * own):
        width = np.where(np.arange(17) == column, size, 0.0)
        expected = (move(own + width) - move(own - width)) / (2 * size)
        worst = np.quantile(np.abs(slopes[:, column] - expected), 0.9)
        assert worst < 1e-5 * np.std(expected), [*servo.unknown, "start", "velocity"][column]


def test_derivatives_carry_no_counts() -> None:
    columns = np.arange(17)
    with pytest.raises(ValueError, match="without encoder steps"):
        simulate_servo(np.arange(3.0), np.ones(3), np.ones(15), 1e-3, STEP, 0.0, 0.0, None, columns)


def check_estimates(fit, within: float, **changes: float) -> None:  # type: ignore[no-untyped-def]
    truth = {**TRUTH, **changes}
    for name, value, std in zip(fit.servo.unknown, fit.theta, fit.theta_std, strict=True):
        if name in truth:
            assert abs(value - truth[name]) < within * truth[name], name
            assert abs(value - truth[name]) < 4 * std, name


def test_the_simulated_loop_is_that_of_small_steps() -> None:
    t = np.arange(0.0, 2.0, 0.01)
    goal = 0.5 * np.sign(np.sin(3 * t)) + 0.2 * np.sin(11 * t)
    servo = Servo(STEP, given={**TRUTH, "gravity_angle": 0.0})
    for quantised in (False, True):
        found = servo.simulate(np.empty(0), t, goal, 0.0, quantised=quantised)
        expected = simulate_by_small_steps(TRUTH, np.append(t, 2.0), np.append(goal, goal[-1]), STEP * quantised, 100)[
            ::10
        ]
        assert np.abs(found - expected).max() < (2.5 if quantised else 0.2) * STEP


def test_a_servo_with_a_known_gain_shows_inertia_friction_gravity_and_delay() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}, terms=["gravity"]), *make_log())
    assert fit.servo.unknown == ("inertia", "viscous", "coulomb", "delay", "gravity")
    check_estimates(fit, 0.05)
    assert fit.status == ()
    assert fit.residual < 1.2 * STEP / math.sqrt(12)


def test_known_gravity_gives_the_gain() -> None:
    servo = Servo(STEP, given={"gravity": 1.3, "gravity_angle": 0.0, "kd": 0.02})
    fit = fit_servo(servo, *make_log(seed=2), search=False)
    assert "kp" in fit.servo.unknown
    check_estimates(fit, 0.05)


def test_a_known_force_gives_the_gain() -> None:
    t, goal, position = make_log(seed=2, kd=0.0)
    force = TRUTH["gravity"] * np.sin(position)
    fit = fit_servo(Servo(STEP, given={"kd": 0.0}), t, goal, position, force=force, search=False)
    assert fit.servo.unknown == ("inertia", "viscous", "coulomb", "kp", "delay")
    check_estimates(fit, 0.05)
    with pytest.raises(UsageError, match="the known force is zero"):
        fit_servo(Servo(STEP), t, goal, position, force=0 * force)


def test_without_any_torque_all_torques_are_multiples_of_the_gain() -> None:
    fit = fit_servo(Servo(STEP), *make_log(seed=3, gravity=0.0, kd=0.0))
    assert fit.names[:3] == ("inertia/kp", "viscous/kp", "coulomb/kp")
    assert fit.units[:3] == ("s2", "s", "rad")
    assert fit.theta[0] == pytest.approx(0.01 / 8.0, rel=0.01)
    assert "relative" in [finding.code for finding in fit.findings]


def test_a_limit_of_the_torque_is_found() -> None:
    log = make_log(seed=4, gravity=0.0, torque_limit=1.5)
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}, terms=["torque_limit"]), *log)
    assert 0.02 < fit.limited < 0.6
    check_estimates(fit, 0.05, torque_limit=1.5)


def test_a_load_that_the_model_lacks_is_found_or_flagged() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *make_log(seed=5))
    assert "gravity" in fit.added
    check_estimates(fit, 0.05)
    plain = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *make_log(seed=5), search=False)
    assert "unmodelled" in plain.status


def test_a_limit_that_the_model_lacks_is_found() -> None:
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), *make_log(seed=4, gravity=0.0, torque_limit=1.5))
    assert fit.added == ("torque_limit",)
    check_estimates(fit, 0.05, torque_limit=1.5)


def test_rows_may_be_missing() -> None:
    t, goal, position = make_log(seed=6, gravity=0.0)
    keep = np.random.default_rng(0).random(t.size) > 0.1
    keep |= np.append(False, np.diff(goal) != 0)  # a command that nobody logged cannot be simulated
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), t[keep], goal[keep], position[keep])
    check_estimates(fit, 0.2, gravity=0.0)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda t, g, y: (t, g[:-1], y), "equally long"),
        (lambda t, g, y: (t[:30], g[:30], y[:30]), "too few"),
        (lambda t, g, y: (t, np.where(t < 1, np.nan, g), y), "goal is not finite in row 0"),
        (lambda t, g, y: (t[::-1], g, y), "does not rise after row 0"),
    ],
)
def test_arrays_that_no_fit_can_use_are_refused(changed, words: str) -> None:  # type: ignore[no-untyped-def]
    t = np.arange(200) * 0.01
    with pytest.raises(UsageError, match=words):
        fit_servo(Servo(STEP), *changed(t, np.sin(t), np.sin(t)))


def test_a_motion_that_does_not_follow_the_command_is_refused() -> None:
    t, goal, position = make_log()
    with pytest.raises(NotIdentifiableError, match="the same joint"):
        fit_servo(Servo(STEP), t, np.random.default_rng(0).permutation(goal), -position)
    with pytest.raises(NotIdentifiableError, match="hardly moves"):
        fit_servo(Servo(STEP), t, goal, 0 * position)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"resolution": 0.0}, "resolution must be positive"),
        ({"resolution": STEP, "given": {"kq": 1.0}}, "did you mean 'kp'"),
        ({"resolution": STEP, "given": {"kp": -1.0}}, "kp must be finite and positive"),
        ({"resolution": STEP, "terms": ["friction"]}, "unknown parameter 'friction'"),
    ],
)
def test_a_servo_of_impossible_values_is_refused(arguments: dict, words: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(UsageError, match=words):
        Servo(**arguments)


def test_a_position_that_scatters_by_more_than_rounding_is_flagged() -> None:
    t, goal, position = make_log(seed=7, gravity=0.0)
    scatter = STEP * np.random.default_rng(7).integers(-2, 3, t.size)
    fit = fit_servo(Servo(STEP, given={"kp": 8.0, "kd": 0.02}), t, goal, position + scatter, search=False)
    assert fit.status == ("unmodelled",)


def test_a_wrong_friction_below_the_rounding_is_flagged() -> None:
    t, rng = np.arange(600) * 0.01, np.random.default_rng(3)
    steps = rng.uniform(-0.5, 0.5, 15).repeat(40)
    goal = np.where(t < 3, steps, 0.4 * np.sin(5 * t) + 0.2 * np.sin(13 * t))
    known = Servo(STEP, given={"kp": 8.0, "kd": 0.0, "loop_delay": 0.0})
    true = replace(known, terms=("stribeck", "stribeck_speed"))
    position = true.simulate(np.array([0.01, 0.3, 0.05, 0.01, 0.02, 0.5]), t, goal, 0.0)
    fit = fit_servo(known, t, goal, STEP * np.rint(position / STEP), search=False)
    assert fit.status == ("unmodelled",)
    assert fit.residual < 1.4 * STEP / math.sqrt(12)


def test_a_direction_that_a_log_hardly_shows_keeps_its_variance() -> None:
    alike = np.array([[1.0, 1.0 - 1e-14, 0.0], [1.0 - 1e-14, 1.0, 0.0], [0.0, 0.0, 0.0]])
    variance = np.diag(invert_curvature(alike))
    assert variance[:2].min() > 1e8
    assert variance[2] == 0
    plain = np.array([[4.0, 1.0], [1.0, 9.0]])
    assert invert_curvature(plain) == pytest.approx(np.linalg.inv(plain))


@pytest.mark.parametrize("seed", range(30, 36))
def test_bars_hold_the_friction_of_a_loop_that_sees_coarse_steps(seed: int) -> None:
    step = 2 * math.pi / 1024
    friction = {"coulomb": 8.0 * step * (0.8 + 0.3 * (seed - 30)), "gravity": 0.0, "kd": 0.0}
    fit = fit_servo(Servo(step, given={"kp": 8.0, "kd": 0.0}), *make_log(seed=seed, step=step, **friction))
    assert fit.status == ()
    for name, value, std in zip(fit.names, fit.theta, fit.theta_std, strict=True):
        assert abs(value - {**TRUTH, **friction}[name]) < 3 * std, name


def test_the_score_of_a_rounded_position_is_the_slope_of_its_cost() -> None:
    deviation, scatter, width = np.linspace(-1.2, 1.2, 13), 0.2, 1e-5
    assert np.isfinite(compute_score(np.array([-1e6, 1e6]), 0.08)).all()
    for moved in deviation:
        slope = (
            compute_cost(np.array([moved + width]), scatter) - compute_cost(np.array([moved - width]), scatter)
        ) / (2 * width)
        assert compute_score(np.array([moved]), scatter)[0] == pytest.approx(slope, rel=1e-6, abs=1e-6)
        bent = np.diff(compute_score(np.array([moved - width, moved + width]), scatter))[0] / (2 * width)
        assert compute_weight(np.array([moved]), scatter)[0] == pytest.approx(bent, rel=1e-5, abs=1e-6)


def test_an_unknown_gain_of_the_loop_is_within_the_bar_of_the_inertia() -> None:
    fit = fit_servo(Servo(STEP), *make_log(seed=8, gravity=0.0, kd=0.05))
    assert fit.names[0] == "inertia/kp"
    assert 0.002 < 1 - fit.theta[0] * 8.0 / 0.01 < 3 * fit.theta_std[0] * 8.0 / 0.01


def make_damped_log(load_friction: float) -> tuple[Servo, Floats, Floats, Floats]:
    """Log of a damped joint without gravity: its motor hardly ever brakes."""
    step, t = 2 * math.pi / 1024, np.arange(600) * 0.01
    rng = np.random.default_rng(12)
    goal = step * np.rint(np.where(t < 0.3, 0, rng.uniform(-0.7, 0.7, 15).repeat(40)) / step)
    servo = Servo(step, given={"kp": 8.0, "kd": 0.0, "loop_delay": 0.0}, terms=["load_friction"])
    position = servo.simulate(np.array([0.005, 0.5, 0.1, 0.015, load_friction]), t, goal, 0.0, quantised=True)
    return servo, t, goal, step * np.rint(position / step)


@pytest.mark.parametrize("named", [True, False])
def test_bars_hold_a_load_friction_that_a_damped_joint_does_not_show(named: bool) -> None:
    servo, t, goal, position = make_damped_log(0.1)
    fit = fit_servo(servo if named else replace(servo, terms=()), t, goal, position, search=named)
    truth = {"inertia": 0.005, "viscous": 0.5, "coulomb": 0.1, "delay": 0.015, "load_friction": 0.1}
    for name, value, std in zip(fit.names, fit.theta, fit.theta_std, strict=True):
        assert abs(value - truth[name]) < 3 * std, name
    assert fit.theta_std[1] > 0.02 * fit.theta[1]


def test_the_study_has_the_friction_of_a_loaded_gearbox() -> None:
    t = np.arange(60) * 0.01
    goal = 0.5 * np.sign(np.sin(14 * t))
    true = TrueServo(0.01, 0.06, 0.05, 8.0, 0.01, 1e-6, gravity=1.3, load_friction=0.2)
    given = {"kp": 8.0, "gravity": 1.3, "gravity_angle": 0.0, "load_friction": 0.2}
    model = Servo(1e-6, given).simulate(np.array([0.01, 0.06, 0.05, 0.01]), t, goal, 0.0)
    assert np.abs(simulate_servos([true], t, [goal])[0] - model).max() < STEP


def test_a_known_loop_has_narrower_bars() -> None:
    log = make_log(seed=3, gravity=0.0, kd=0.0)
    known, open_loop = (
        fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.0, **more}), *log) for more in ({"loop_delay": 0.0}, {})
    )
    assert known.theta_std[1] < 0.7 * open_loop.theta_std[1]


@pytest.mark.parametrize("cogging", [0.0, 0.02])
def test_cogging_next_to_a_known_gravity_is_doubted(cogging: float) -> None:
    """Another gain explains most of such a torque, so that no residual shows it."""
    t, goal, _ = make_log(time=6.0)
    true = Servo(STEP, {"kp": 8.0, "gravity": 1.3, "gravity_angle": 0.0})
    position = np.zeros(t.size)
    for _ in range(6):  # the torque of the position as one of the time
        position = true.simulate(np.array([0.01, 0.06, 0.05, 0.01]), t, goal, 0.0, force=cogging * np.sin(3 * position))
    servo = Servo(STEP, {"gravity": 1.3, "gravity_angle": 0.0, "kd": 0.0})
    fit = fit_servo(servo, t, goal, STEP * np.rint(position / STEP))
    apart = abs(fit.theta[fit.names.index("kp")] - 8.0) / fit.theta_std[fit.names.index("kp")]
    assert fit.status == (("unmodelled",) if cogging else ())
    assert (apart > 3) == (cogging > 0)


def test_a_friction_may_rise_with_the_speed() -> None:
    servo = Servo(STEP, {"kp": 8.0, "stribeck": -0.01, "stribeck_speed": 1.0})
    t = np.arange(0.0, 1.0, 0.01)
    slow = servo.simulate(np.array([0.01, 0.06, 0.05, 0.01]), t, t, 0.0)
    plain = replace(servo, given={"kp": 8.0}).simulate(np.array([0.01, 0.06, 0.05, 0.01]), t, t, 0.0)
    assert slow[-1] > plain[-1]
    with pytest.raises(UsageError, match="load_friction must be"):
        Servo(STEP, {"load_friction": -0.1})


def test_gravity_is_found_at_a_given_angle() -> None:
    t, goal, position = make_log()
    fit = fit_servo(Servo(STEP, {"kp": 8.0, "kd": 0.02, "gravity_angle": 0.0}), t, goal, position)
    assert "gravity" in fit.added
    assert abs(fit.theta[fit.names.index("gravity")] - TRUTH["gravity"]) < 0.02
