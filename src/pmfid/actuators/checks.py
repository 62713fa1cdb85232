"""Mistakes in a log of a servo that no fit can mend, each with its remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pmfid.actuators.logs import JointLog
from pmfid.actuators.tuning import TUNING
from pmfid.errors import UsageError
from pmfid.types import Flags, Floats


def check_joint(log: JointLog, others: Sequence[JointLog]) -> None:
    """Raise UsageError for a goal in another unit, of another joint, of the other sign, or without effect.

    `others` are all joints of the log, on one clock. A joint that hardly moves passes, for a fit says so.
    """
    log = log if log.on is None else log.cut(log.on > 0)
    if log.t.size < TUNING.least_checked or min(np.ptp(log.goal), np.ptp(log.position)) < 3 * log.resolution:
        return
    own = correlate(log.t, log.goal, log.position)
    for other in others:
        if other.name != log.name and abs(own) < TUNING.exchanged and np.ptp(other.goal) > 0:
            best = correlate(log.t, np.interp(log.t, other.t, other.goal), log.position)
            if best > max(TUNING.exchanged, abs(own) + TUNING.better):
                raise UsageError(
                    f"the position follows the goal of joint {other.name} (correlation {best:.2f}), not its own goal "
                    f"({own:.2f}): exchange the columns"
                )
    if abs(own) < TUNING.follows:
        raise UsageError(
            f"the position does not follow the goal (correlation {own:.2f}): check the columns, or turn the torque on"
        )
    if own < 0:
        raise UsageError("the position moves against the goal: reverse the sign of one column")
    _check_units(log)


def correlate(t: Floats, goal: Floats, position: Floats) -> float:
    """Return the correlation of the position with the goal at the lag at which its magnitude is largest."""
    period = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], period)
    held = goal[np.searchsorted(t, grid + 1e-9 * period, side="right") - 1]
    moved, best = np.interp(grid, t, position), 0.0
    most = min(int(TUNING.longest_lag / period), grid.size // 4)
    for lag in range(-most, most + 1):
        first, second = held[max(-lag, 0) : held.size - max(lag, 0)], moved[max(lag, 0) : moved.size - max(-lag, 0)]
        first, second = first - first.mean(), second - second.mean()
        size = float(np.linalg.norm(first) * np.linalg.norm(second))
        found = float(first @ second) / size if size > 0 else 0.0
        if abs(found) > abs(best):
            best = found
    return best


def find_stops(log: JointLog) -> Flags:
    """Return the rows (n,) in which the joint rests at a stop. There it comes back at least three times to one extreme
    position, to a step of the encoder, under goals beyond it that differ by more than its typical lag."""
    stopped, low, high = np.zeros(log.t.size, bool), log.position.min(), log.position.max()
    inside = np.abs(log.position - (low + high) / 2) < (high - low) / 2 - 1.5 * log.resolution
    lag = np.std((log.goal - log.position)[inside])
    for side in (1.0, -1.0):
        y, goal = side * log.position, side * log.goal
        there = y > y.max() - 1.5 * log.resolution
        ends = np.flatnonzero(np.diff(there, prepend=False, append=False)).reshape(-1, 2)
        goals = [float(np.median(goal[slice(*rows)])) for rows in ends if np.ptp(rows) > 2]
        goals = [one for one in goals if one > y.max()]
        if len(goals) > 2 and np.ptp(goals) > lag:
            stopped |= there
    return stopped


def _check_units(log: JointLog) -> None:
    """Raise UsageError if goal and position differ by the factor of another unit."""
    ratio = float(np.std(log.position) / np.std(log.goal))
    units = {"degrees": math.pi / 180, "counts": log.resolution}
    for unit, factor in sorted(units.items(), key=lambda item: abs(math.log(ratio / item[1]))):
        short = {"degrees": "deg"}.get(unit, unit)
        if abs(math.log(ratio / factor)) < math.log(TUNING.unit_within):
            raise UsageError(f"the goal is in {unit} and the position in rad: give --goal-unit {short}")
        if abs(math.log(ratio * factor)) < math.log(TUNING.unit_within):
            raise UsageError(f"the position is in {unit} and the goal in rad: give --unit {short} --goal-unit rad")
