"""Standard errors of the parameters of a servo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.rivals import compute_rival_changes
from pmfid.actuators.rounding import RoundedFit, evaluate_rounded, invert_curvature
from pmfid.actuators.servo import SIGNED, Servo
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats


def standard_errors(problem: ServoProblem, z: Floats) -> Floats:
    """Return the standard errors (p,) at the estimate `z`, in the units of the parameters."""
    now, slope = _lift_zeros(problem, z)
    variance = np.diag(_covariance(problem, z, now, slope))[: -TUNING.nuisance] * np.square(slope)
    for change in compute_rival_changes(problem, z):  # the curvature of the likelihood already knows near rivals
        moved = np.square(change)
        share = np.max(1 - variance / np.maximum(moved, 1e-12 * variance + 1e-300))
        variance = variance + max(share, 0.0) * moved
    return np.asarray(np.sqrt(variance))


def _lift_zeros(problem: ServoProblem, z: Floats) -> tuple[RoundedFit, Floats]:
    """Return the likelihood at coordinates (p + 2,), and the size (p,) of a unit of each coordinate.

    The logarithm of a parameter that ended at zero has no effect. Such a coordinate becomes the parameter itself.
    """
    now, theta = evaluate_rounded(problem, z), problem.theta(z)
    jacobian, slope = now.jacobian.copy(), np.where(problem.positive, theta, problem.scale)
    for index, name in enumerate(problem.servo.unknown):
        if name not in SIGNED and np.linalg.norm(jacobian[:, index]) < TUNING.no_effect:
            slope[index], moved = _unit(problem, z, name), z.copy()
            moved[index] = np.log(theta[index] + TUNING.lift * slope[index])
            change = problem.residual(moved) / problem.servo.resolution - now.deviation
            jacobian[:, index] = change / TUNING.lift
    return replace(now, jacobian=jacobian), slope


def _covariance(problem: ServoProblem, z: Floats, now: RoundedFit, slope: Floats) -> Floats:
    """Return the covariance of the coordinates (p + 2, p + 2): scores of blocks, and neglected parts of the loop."""
    n = problem.t.size
    white = invert_curvature(now.curvature)
    time = float(problem.t[-1] - problem.t[0])
    blocks = int(np.clip(time / TUNING.shortest_block, 2, TUNING.blocks))
    edges = np.linspace(0, n, blocks + 1).astype(int)
    scores = np.add.reduceat(now.scores, edges[:-1], axis=0)
    half = scores @ white.T
    spread = blocks / (blocks - 1) * half.T @ half
    # The larger of both for each coordinate, with the correlations of the blocks.
    factor = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(spread), 1e-300), 1.0))
    covariance = now.misfit**2 * spread * np.outer(factor, factor)
    for shift in _neglected_shifts(problem, z, now, slope):
        covariance = covariance + now.misfit**2 * np.outer(shift, shift)
    return np.asarray(covariance)


def _neglected_shifts(problem: ServoProblem, z: Floats, now: RoundedFit, slope: Floats) -> list[Floats]:
    """Return what the neglected parts of the loop shift the coordinates by: list of (p + 2,).

    These parts are half a period of delay in the loop, the encoder's step in the loop, the phase of the ticks, and the
    part of viscous friction that the loop makes. A given `loop_delay` says that the loop is known.
    """
    servo, theta, step = problem.servo, problem.theta(z), problem.servo.resolution
    start, velocity = float(problem.position[0]) + z[-2] * step, z[-1] * problem.speed

    def simulate(other: Servo, values: Floats, own: float = 0.0, grid: float = 0.0, *, on: bool = False) -> Floats:
        """Return the position [steps], from `own` steps after the start, on counts that are `grid` steps earlier."""
        goal, first = problem.goal + grid * step, start + (own + grid) * step
        return other.simulate(values, problem.t, goal, first, velocity, quantised=on, force=problem.force) / step - grid

    phases, fine, shifts = np.arange(TUNING.phases) / TUNING.phases, simulate(servo, theta), []
    for phase in phases:  # the steps of goals and positions may differ by any part of a step
        changes = simulate(servo, theta, phase, on=True) - simulate(servo, theta, phase)
        shifts.append(now.shift(changes) / np.sqrt(phases.size))
        shifts.append(now.shift(simulate(servo, theta, 0.0, phase, on=True) - fine) / np.sqrt(phases.size))
    late = replace(
        servo, given={**servo.given, "loop_delay": servo.given.get("loop_delay", 0.0) + servo.loop_period / 2}
    )
    share = TUNING.known_loop if "loop_delay" in servo.given else 1.0
    if late.unknown == servo.unknown:
        shifts.append(share * now.shift(simulate(late, theta) - fine))
    shifts.append(now.shift(replace(problem, counted=False, phase=TUNING.late_ticks).simulate(z) / step - fine))
    if not servo.has("kd") and "viscous" in servo.unknown:
        free = _free_torque(servo, theta)
        shift = now.shift(simulate(*_move_viscous(*free)) - simulate(*free))
        if "torque_limit" in servo.unknown:  # the limit cuts the loop's part off as well
            index = servo.unknown.index("torque_limit")
            shift[index] = now.shift(simulate(*_move_viscous(servo, theta)) - fine)[index]
        shifts.append(shift)
    if "delay" in servo.unknown:
        index = servo.unknown.index("delay")
        tick = np.zeros_like(z)
        tick[index] = share * servo.loop_period / np.sqrt(12) / max(slope[index], servo.loop_period * 1e-3)
        shifts.append(tick)
    return shifts


def _free_torque(servo: Servo, theta: Floats) -> tuple[Servo, Floats]:
    """Return a servo whose torque has no limit, and its parameters (p,)."""
    given, values = dict(servo.given), theta.copy()
    if "torque_limit" in given:
        given["torque_limit"] = TUNING.no_limit
    if "torque_limit" in servo.unknown:
        values[servo.unknown.index("torque_limit")] = TUNING.no_limit
    return replace(servo, given=given), values


def _move_viscous(servo: Servo, theta: Floats) -> tuple[Servo, Floats]:
    """Return a servo whose loop makes a part of the viscous friction, and its parameters (p,)."""
    values, index = theta.copy(), servo.unknown.index("viscous")
    values[index] *= 1 - TUNING.loop_share
    scale = {"kp": 1.0} if servo.relative else {}
    return replace(servo, given={**servo.given, **scale, "kd": TUNING.loop_share * float(theta[index])}), values


def _unit(problem: ServoProblem, z: Floats, name: str) -> float:
    """Return a value of a parameter that has a clear effect."""
    now = problem.list_values(z)
    torque = problem.torque(now.get("kp"))
    units = {
        "inertia": now.get("inertia", 1.0),
        "viscous": torque / problem.speed,
        "kd": torque / problem.speed,
        "delay": 100 * float(np.median(np.diff(problem.t))),
    }
    return float(units.get(name, torque))
