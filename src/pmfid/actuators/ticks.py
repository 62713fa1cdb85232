"""The error of a loop in continuous time: the loop of a servo runs in ticks, on counts.

Ticks and counts are no noise: a derivative gain turns the step of a count into a pulse of torque, which loosens the
friction. The servo is simulated as its firmware runs, at the parameters of the fit, and its distance from the motion of
the body is an error of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid._body import BASE, LOOP, run_firmware
from pmfid.actuators.search import ServoSearch
from pmfid.actuators.tuning import TUNING
from pmfid.fit.machine import DELAY, BodyForce
from pmfid.fit.problem import ObservedStretch, ResidualBlock
from pmfid.fit.solve import inverse, normal_of
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class Ticks:
    """Effect of the ticks of a loop: the shift (p,) of the coordinates to add, the probability that it is there, and
    the gain of the log likelihood."""

    shift: Floats
    chance: float
    gain: float

    @property
    def mean(self) -> Floats:
        return self.chance * self.shift

    @property
    def covariance(self) -> Floats:
        """Covariance (p, p) of a shift that is as uncertain as it is large."""
        return self.chance * np.outer(self.shift, self.shift)


def measure_ticks(search: ServoSearch, q: Floats) -> Ticks:
    """Return the effect of the ticks at the coordinates q (p,) of a solved search.

    The body follows a loop in ticks at q from other coordinates. What no coordinates follow is sought in the residuals,
    where a part of it between 0 and 1 recurs: the phases of the counts are chaotic. The delay of the loop in ticks is
    half a period. A log with known torques or with the torque off shows none of this.
    """
    servo, problem = search.task.servo, search.problem
    if any(log.force is not None or log.on is not None for log in search.task.logs):
        return Ticks(np.zeros(q.size), 0.0, 0.0)
    q, starts, names = q.copy(), search.starts, problem.machine.names
    if "loop_delay" in names:
        q[names.index("loop_delay")] = 0.0
    apart = []
    for block, stretch, state, scale in zip(
        problem.linearise(q, starts), problem.stretches, starts, problem.scales(), strict=True
    ):
        body, forces, _ = problem._body(q, stretch.acts)
        at = problem._start_body(stretch, state, scale, body)
        used = stretch.times <= TUNING.ticked
        y = run_ticks(stretch, split_loop(at, forces), servo.loop_period, problem.resolution, problem.parts)
        e = np.where(used, block.e - (y - stretch.y) / problem.resolution, 0.0)
        apart.append(ResidualBlock(np.clip(e, -1e3, 1e3), block.J * used[:, None], block.K * used[:, None]))
    weighted, solved = search.noise(apart)[1], search.noise(problem.linearise(search.q, starts))[1]
    normal = normal_of(weighted, np.zeros_like(starts))
    moved = -inverse(normal.A + np.diag(search.prior(problem))) @ normal.g
    left = [
        block.e + block.J @ moved + block.K @ start for block, start in zip(weighted, normal.starts(moved), strict=True)
    ]
    along = sum(float(e @ block.e) for e, block in zip(left, solved, strict=True))
    size = sum(float(e @ e) for e in left)
    part = np.linspace(0.0, 1.0, 1001)
    odds = float(np.logaddexp.reduce(part * along - 0.5 * part**2 * size)) - math.log(part.size)
    gain = float(np.logaddexp(odds, 0.0))
    return Ticks(-moved, math.exp(odds - gain), gain - math.log(2))


@dataclass(frozen=True, eq=False)
class Firmware:
    """The joint without its loop, and the gains of the loop. A velocity without a lag is the difference of counts."""

    body: Floats
    forces: list[BodyForce]
    kp: float
    limit: float
    kd: float
    lag: float | None
    ki: float


def split_loop(at: Floats, forces: Sequence[BodyForce]) -> Firmware:
    """Return the joint and the gains of a body (w,) with a loop."""
    sizes, shapes = at[BASE : BASE + len(forces)], list(at[BASE + len(forces) : -LOOP])
    gains = {"loop_velocity": 0.0, "loop_filtered": 0.0, "loop_integral": 0.0}
    joint, of_joint, constants, lag = [], [], [], None
    for force, size in zip(forces, sizes.tolist(), strict=True):
        constant = float(shapes.pop(0)) if force.free else force.p
        if force.kind in gains:
            gains[force.kind] += size
            lag = constant if force.kind == "loop_filtered" else lag
        else:
            joint.append(force)
            of_joint.append(size)
            constants += [constant] if force.free else []
    body = np.array([*at[:BASE], *of_joint, *constants])
    kd = gains["loop_velocity"] + gains["loop_filtered"]
    return Firmware(body, joint, float(at[-LOOP]), float(at[1 - LOOP]), kd, lag, gains["loop_integral"])


def run_ticks(stretch: ObservedStretch, firmware: Firmware, period: float, resolution: float, parts: int) -> Floats:
    """Return the positions (k,) [rad] at the observations, up to `TUNING.ticked`."""
    ends = np.append(0.0, np.cumsum(stretch.drive.step))
    last, delay = min(float(ends[-1]), TUNING.ticked), float(firmware.body[DELAY])
    ticks = np.append(0.0, np.arange(delay % period, last + period, period))
    goals = stretch.drive.u[np.clip(np.searchsorted(ends, ticks - delay + 1e-9, side="right") - 1, 0, ends.size - 2)]
    lag = 0.5 * period if firmware.lag is None else firmware.lag
    share = -math.expm1(-period / max(lag - 0.5 * period, 1e-9))
    body, packed = firmware.body.copy(), [force.pack() for force in firmware.forces]
    body[DELAY] = 0.0
    counted = min(2 * lag / period, 1.0)  # a difference of counts is half a period old
    gains = firmware.kp, firmware.limit, counted * firmware.kd, (1 - counted) * firmware.kd, share, firmware.ki
    path = run_firmware(
        packed,
        np.ascontiguousarray(goals),
        np.diff(ticks, append=last + 2 * period),
        body,
        (*gains, period, resolution),
        parts,
    )
    return _interpolate(stretch.times, ticks, path)


def _interpolate(times: Floats, ticks: Floats, path: Floats) -> Floats:
    """Return the positions (k,) at times (k,) from positions and velocities (n, 2) at ticks (n,)."""
    k = np.clip(np.searchsorted(ticks, times, side="right") - 1, 0, ticks.size - 2)
    step = np.maximum(ticks[k + 1] - ticks[k], 1e-12)
    s = np.clip((times - ticks[k]) / step, 0.0, 1.0)
    x0, x1, v0, v1 = path[k, 0], path[k + 1, 0], path[k, 1] * step, path[k + 1, 1] * step
    return np.asarray(x0 + s * v0 + s * s * (3 * (x1 - x0) - 2 * v0 - v1) + s**3 * (2 * (x0 - x1) + v0 + v1))
