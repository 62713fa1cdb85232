"""Torques that turn with the position: cogging, or a known gravity that is not the true one.

The residual hides such a torque if gravity is known, because another gain then explains most of it. A score test shows
it: to first order, how much likelier a small torque makes the log, and how far it moves the estimates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.rounding import (
    RoundedFit,
    compute_score,
    compute_weight,
    evaluate_rounded,
    measure_independence,
    solve_scaled,
)
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats


def measure_wave(problem: ServoProblem, z: Floats, std: Floats) -> float:
    """Return how many standard errors (p,) a torque of the position moves an estimate by, and 0 if none is likely.

    Only a servo with gravity or a known torque has such a test. A wave so fast that it moves no estimate measures what
    chance and the loop explain.
    """
    if problem.is_contradicted(z) or not (problem.servo.has("gravity") or problem.force is not None):
        return 0.0
    now, theta = evaluate_rounded(problem, z), problem.theta(z)
    (gain, change), (chance, _) = (_explain(problem, z, now, waves) for waves in TUNING.waves)
    if gain < max(TUNING.wave_gain, TUNING.wave_ratio * chance):
        return 0.0
    clear = np.linalg.norm(now.jacobian, axis=0)[: -TUNING.nuisance] > TUNING.no_effect
    moved = change[: -TUNING.nuisance] * np.where(problem.positive, theta, problem.scale)
    return float(np.max(np.abs(moved[clear]) / std[clear], initial=0.0))


def _explain(problem: ServoProblem, z: Floats, now: RoundedFit, waves: float) -> tuple[float, Floats]:
    """Return what a torque with `waves` a turn gains in the likelihood, and the change (p + 2,) of the coordinates.

    The gain counts independent samples.
    """
    plain, step = replace(problem, counted=False), problem.servo.resolution
    known = np.zeros(problem.t.size) if problem.force is None else problem.force
    size, here = TUNING.lift * problem.torque(problem.list_values(z).get("kp")), plain.residual(z)
    pushed = [known + size * turn(waves * problem.position) for turn in (np.sin, np.cos)]
    columns = np.stack([(replace(plain, force=force).residual(z) - here) / step for force in pushed], axis=1)
    weight, score = compute_weight(now.deviation, now.scatter), compute_score(now.deviation, now.scatter)
    shared = (now.jacobian * weight[:, None]).T @ columns
    absorbed = solve_scaled(now.curvature, shared)
    own = columns - now.jacobian @ absorbed
    slope, bend = own.T @ score, (own * weight[:, None]).T @ own
    amplitude = -solve_scaled(bend, slope)
    return float(-0.5 * slope @ amplitude) * measure_independence(now.deviation), -absorbed @ amplitude
