"""The parameters of a servo and their standard errors, from the coordinates of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators.body import CONSTANTS
from pmfid.actuators.lags import LagFit, mix
from pmfid.actuators.search import ServoSearch, limited_part
from pmfid.actuators.terms import LOOP_FRICTION
from pmfid.actuators.tuning import TUNING
from pmfid.fit.fit import Fitted, sandwich
from pmfid.fit.problem import ResidualBlock
from pmfid.fit.solve import inverse
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class ParameterReader:
    """The function from coordinates (p,) of a fit to parameters by name. The lag of the velocity in the loop comes
    last if the fit has one. `gain` says whether the log shows the derivative gain: below the limit of the torque, only
    the age of the velocity tells it from viscous friction."""

    search: ServoSearch
    fitted: Fitted
    gain: bool = False

    def __call__(self, q: Floats) -> dict[str, float]:
        found = self._read_machine(q)
        self._read_forces(q, found)
        self._place_loop(found, float(q[-1]))
        self._read_waves(q, found)
        asked = self.search.task.servo.unknown
        if "gravity" in asked and "gravity_angle" in asked:
            found |= _polar(found["gravity"], found["gravity_angle"])
        elif "gravity_angle" in asked:
            found["gravity_angle"] = math.remainder(found["gravity_angle"], math.tau)
        return found

    def _read_machine(self, q: Floats) -> dict[str, float]:
        """Return the parameters of the model. A delay of the loop that nobody named only widens the others."""
        problem, task = self.fitted.problem, self.search.task
        found, shifts = {}, {"inertia": task.load, "delay": -task.lead}
        for name, value in zip(problem.machine.names, problem.theta(q).tolist(), strict=True):
            base = name.partition(".")[0]
            mean, sd = task.priors.get(base, (0.0, 1.0))
            if base != "loop_delay" or "loop_delay" in task.servo.unknown:
                found[name] = mean + sd * value + shifts.get(base, 0.0)
        return found

    def _read_forces(self, q: Floats, found: dict[str, float]) -> None:
        """Write the sizes of the terms that were found."""
        for k, one in self.fitted.problem.place_candidates():
            if one.force is not None and one.force.kind in ("wave", "rub"):
                continue
            found[one.name] = found.get(one.name, 0.0) + float(q[k]) * one.sd
            if one.free:
                found[CONSTANTS[one.name]] = float(q[k + 1]) * one.constant

    def _place_loop(self, found: dict[str, float], lag: float) -> None:
        """Name the friction of the loop if the log shows it, and add it to the viscous friction if not."""
        loop = found.pop(LOOP_FRICTION, None)
        if loop is not None and self.gain:
            found |= {"kd": loop, "velocity_filter": lag}
        elif loop is not None:
            found["viscous"] = found.get("viscous", 0.0) + loop

    def _read_waves(self, q: Floats, found: dict[str, float]) -> None:
        """Write the sizes of the effects that turn with the position."""
        waves: dict[str, list[float]] = {}
        for k, one in self.fitted.problem.place_candidates():
            force = one.force
            if force is not None and force.kind in ("wave", "rub"):
                waves.setdefault(one.name, [0.0, 0.0])[not one.free and force.q > 0] = float(q[k]) * one.sd
        for name, (sine, cosine) in waves.items():
            polar = _polar(sine, cosine)
            found |= polar if name == "gravity" else {name: polar["gravity"]}


def _polar(sine: float, cosine: float) -> dict[str, float]:
    """Return gravity and the angle at which it is zero, for the sizes of its sine and its cosine."""
    return {"gravity": math.hypot(sine, cosine), "gravity_angle": math.atan2(-cosine, sine)}


def read_parameters(
    search: ServoSearch, fitted: Fitted, lags: Sequence[LagFit]
) -> tuple[tuple[str, ...], Floats, Floats]:
    """Return names, values and standard errors (m,) of the parameters that were known or found."""
    q, covariance, gain = fitted.solution.q, _scatter(search, fitted), False
    if lags:
        q, covariance = _mix_lags(search, fitted, lags, covariance)
        at = next(k for k, one in fitted.problem.place_candidates() if one.name == LOOP_FRICTION)
        local, without = search.local(search.noise), [i for i in search.chosen if i not in search.kept]
        limited = limited_part(fitted.problem, fitted.solution.q, fitted.solution.starts) > 0
        shown = limited and local.evidence(search.chosen)[0] > local.evidence(without)[0]
        gain = shown and math.sqrt(covariance[at, at]) < TUNING.open * q[at]
    read = ParameterReader(search, fitted, gain)
    found = read(q)
    names, theta = tuple(found), np.array(list(found.values()))
    width = np.nan_to_num(np.sqrt(np.abs(np.diag(covariance))), nan=1.0, posinf=1.0)
    gradient = _gradient(read, q, width)
    std = _widen(search, gradient, _spread(gradient, covariance))
    more = {"delay": search.task.servo.loop_period / math.sqrt(12)}  # a goal waits for the next tick of the loop
    if search.is_lost(fitted.solution.q):
        more[search.plain.machine.names[search.plain.machine.lead]] = math.inf
    std = np.hypot(std, [more.get(name, 0.0) for name in names])
    std = np.where(np.isfinite(std) & (std > 0), std, np.inf)
    return names, theta, np.maximum(std, TUNING.least_error * np.abs(theta))


def _mix_lags(search: ServoSearch, fitted: Fitted, lags: Sequence[LagFit], plain: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of the coordinates and the lag, as much wider than by the information of the log as
    the covariance `plain` (p, p) at the best lag."""
    q, covariance = mix(lags)
    A = fitted.solution.normal.A + np.diag(search.prior(search.problem))
    wide = np.sqrt(np.maximum(np.diag(plain) / np.maximum(np.diag(inverse(A)), 1e-300), 1.0))
    known = np.append(np.isfinite(wide), True)
    wide = np.where(known, np.append(wide, 1.0), 0.0)
    return q, covariance * np.outer(wide, wide) + np.diag(np.where(known, 0.0, np.inf))


def _widen(search: ServoSearch, gradient: Floats, std: Floats) -> Floats:
    """Return the standard errors (m,) with the spread over models that the logs do not exclude, for derivatives (m, p).

    A parameter may be a sum of coordinates, which another model moves against one another.
    """
    known = np.isfinite(std)
    rows = gradient[:, [*range(search.count), *search.problem.places]][known]
    local, std = search.local(search.noise), std.copy()
    std[known] = local.half_length(search.chosen, range(len(search.table)), std[known] ** 2, rows)[0] / TUNING.normal
    return std


def _scatter(search: ServoSearch, fitted: Fitted) -> Floats:
    """Return the covariance (p, p) of the coordinates in the chosen model, infinite where the logs say nothing."""
    normal, prior = fitted.solution.normal, search.prior(search.problem)
    known = np.diag(normal.A) + prior > 0
    blocks = [ResidualBlock(block.e, block.J[:, known], block.K) for block in normal.blocks]
    inner = [part[:, np.append(True, known)] for part in normal.inner]
    covariance = np.diag(np.where(known, 0.0, np.inf))
    covariance[np.ix_(known, known)] = sandwich(replace(normal, blocks=blocks, inner=inner), prior[known])
    return covariance


def _spread(gradient: Floats, covariance: Floats) -> Floats:
    """Return the standard errors (m,) for derivatives (m, p), infinite if a coordinate without information matters."""
    known = np.isfinite(np.diag(covariance))
    inner, part = covariance[np.ix_(known, known)], gradient[:, known]
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", part, inner, part), 0.0))
    return np.where(np.any(gradient[:, ~known] != 0, axis=1), np.inf, std)


def _gradient(read: ParameterReader, q: Floats, std: Floats) -> Floats:
    """Return the derivatives (m, p) of the parameters by the coordinates."""
    columns = []
    for k in range(q.size):
        width = np.zeros(q.size)
        width[k] = 1e-4 * min(max(std[k], 1e-9 * abs(q[k]), 1e-12), 1.0)
        above, below = (list(read(q + side * width).values()) for side in (1, -1))
        columns.append((np.array(above) - np.array(below)) / (2 * width[k]))
    return np.stack(columns, axis=1)
