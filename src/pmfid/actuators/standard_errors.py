"""Standard errors of the parameters of a servo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.servo import SIGNED
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats


def standard_errors(problem: ServoProblem, z: Floats) -> Floats:
    """Return the standard errors (p,) at the minimum `z`, in the units of the parameters."""
    theta = problem.theta(z)
    slope = np.where(problem.positive, theta, problem.scale)
    covariance = _covariance(problem, z, problem.jacobian(z), problem.residual(z))
    std = np.sqrt(np.diag(covariance))[: -TUNING.nuisance] * slope
    small = _error_at_zero(problem, z, theta)
    return np.asarray(np.where(np.isnan(small), std, small))


def _covariance(problem: ServoProblem, z: Floats, jacobian: Floats, residual: Floats) -> Floats:
    """Return the covariance of the coordinates (p + 2, p + 2): scores of blocks, and the unknown delay of the loop."""
    n, count = jacobian.shape
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    time = float(problem.t[-1] - problem.t[0])
    blocks = int(np.clip(time / TUNING.shortest_block, 2, TUNING.blocks))
    edges = np.linspace(0, n, blocks + 1).astype(int)
    scores = np.add.reduceat(jacobian * residual[:, None], edges[:-1], axis=0)
    spread = blocks / (blocks - 1) * bread @ (scores.T @ scores) @ bread
    white = bread * max(float(residual @ residual) / max(n - count, 1), problem.servo.resolution**2 / 12)
    # The larger of both for each coordinate, with the correlations of the blocks.
    factor = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(spread), 1e-300), 1.0))
    covariance = spread * np.outer(factor, factor)
    for shift in _neglected_shifts(problem, z, bread @ jacobian.T, residual):
        covariance = covariance + np.outer(shift, shift)
    return np.asarray(covariance)


def _neglected_shifts(problem: ServoProblem, z: Floats, solve: Floats, residual: Floats) -> list[Floats]:
    """Return what the neglected parts of the loop shift the coordinates by: list of (p + 2,).

    These parts are half a period of delay in the loop, the encoder's step in the loop, and the phase of the ticks.
    """
    servo, theta, shifts = problem.servo, problem.theta(z), []
    start, velocity = float(problem.position[0]) + z[-2] * servo.resolution, z[-1] * problem.speed
    for phase in (0.0, 0.5):
        own = start + phase * servo.resolution
        stepped, fine = (
            servo.simulate(theta, problem.t, problem.goal, own, velocity, quantised=on) for on in (True, False)
        )
        shifts.append(solve @ (stepped - fine))
    late = replace(
        servo, given={**servo.given, "loop_delay": servo.given.get("loop_delay", 0.0) + servo.loop_period / 2}
    )
    if late.unknown == servo.unknown:
        shifts.append(solve @ (ServoProblem(late, problem.t, problem.goal, problem.position).residual(z) - residual))
    if "delay" in servo.unknown:
        index = servo.unknown.index("delay")
        tick = np.zeros_like(z)
        tick[index] = servo.loop_period / np.sqrt(12) / max(theta[index], servo.loop_period * 1e-3)
        shifts.append(tick)
    return shifts


def _error_at_zero(problem: ServoProblem, z: Floats, theta: Floats) -> Floats:
    """Return standard errors (p,) of positive parameters that ended at zero, and NaN for all others.

    The logarithm of such a parameter has no derivative. The standard error is that of the parameter itself.
    """
    out = np.full(theta.size, np.nan)
    residual, base = problem.residual(z), problem.jacobian(z)
    for index, name in enumerate(problem.servo.unknown):
        if name in SIGNED or np.linalg.norm(base[:, index]) > problem.servo.resolution * 1e-3:
            continue
        width = 1e-3 * _unit(problem, z, name)
        moved = z.copy()
        moved[index] = np.log(theta[index] + width)
        column = (problem.residual(moved) - residual) / width
        others = np.delete(base, index, axis=1)
        column = column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
        variance = max(float(np.mean(residual**2)), problem.servo.resolution**2 / 12)
        information = float(column @ column)
        out[index] = np.sqrt(variance / information) if information > 0 else np.inf
    return out


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
