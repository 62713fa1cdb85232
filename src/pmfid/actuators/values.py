"""The parameters of a servo and their standard errors, from the coordinates of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators.body import CONSTANTS
from pmfid.actuators.search import ServoSearch
from pmfid.actuators.terms import LOOP_FRICTION
from pmfid.actuators.tuning import TUNING
from pmfid.fit.fit import Fitted, sandwich
from pmfid.fit.problem import ResidualBlock
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class ParameterReader:
    """The function from coordinates (p,) of a fit to parameters by name."""

    search: ServoSearch
    fitted: Fitted

    def __call__(self, q: Floats) -> dict[str, float]:
        found = self._read_machine(q)
        lags = self._read_forces(q, found)
        self._place_loop(found, lags)
        self._read_waves(q, found)
        asked = self.search.task.servo.unknown
        if "gravity" in asked and "gravity_angle" in asked:
            found |= _polar(found["gravity"], found["gravity_angle"])
        return found

    def _read_machine(self, q: Floats) -> dict[str, float]:
        """Return the parameters of the model. A delay of the loop that nobody named only widens the others."""
        problem, task = self.fitted.problem, self.search.task
        found = {}
        for name, value in zip(problem.machine.names, problem.theta(q).tolist(), strict=True):
            base = name.partition(".")[0]
            mean, sd = task.priors.get(base, (0.0, 1.0))
            if base != "loop_delay" or "loop_delay" in task.servo.unknown:
                found[name] = mean + sd * value + (task.load if name == "inertia" else 0.0)
        return found

    def _read_forces(self, q: Floats, found: dict[str, float]) -> float:
        """Write the sizes of the terms that were found, and return the sum of velocity gains times their lags."""
        lags = 0.0
        for k, one in self.fitted.problem.place_candidates():
            size, force = float(q[k]) * one.sd, one.force
            if force is not None and force.kind in ("wave", "rub"):
                continue
            found[one.name] = found.get(one.name, 0.0) + size
            if one.free:
                found[CONSTANTS[one.name]] = float(q[k + 1]) * one.constant
            elif force is not None and force.kind == "loop_filtered":
                lags += size * force.p
        return lags

    def _place_loop(self, found: dict[str, float], lags: float) -> None:
        """Add the friction of the loop to kd if the logs show kd, and to the viscous friction if not."""
        has_loop, loop = LOOP_FRICTION in found, found.pop(LOOP_FRICTION, 0.0)
        if "kd" in found and "kd" not in self.fitted.problem.machine.names:
            found["kd"] += loop
            found["velocity_filter"] = lags / found["kd"] if found["kd"] > 0 else 0.0
        elif has_loop:
            found["viscous"] = found.get("viscous", 0.0) + loop

    def _read_waves(self, q: Floats, found: dict[str, float]) -> None:
        """Write the sizes of the effects that turn with the position."""
        waves: dict[str, list[float]] = {}
        for k, one in self.fitted.problem.place_candidates():
            force = one.force
            if force is not None and force.kind in ("wave", "rub"):
                waves.setdefault(one.name, [0.0, 0.0])[force.q > 0] = float(q[k]) * one.sd
        for name, (sine, cosine) in waves.items():
            polar = _polar(sine, cosine)
            found |= polar if name == "gravity" else {name: polar["gravity"]}


def _polar(sine: float, cosine: float) -> dict[str, float]:
    """Return gravity and the angle at which it is zero, for the sizes of its sine and its cosine."""
    return {"gravity": math.hypot(sine, cosine), "gravity_angle": math.atan2(-cosine, sine)}


def read_parameters(search: ServoSearch, fitted: Fitted) -> tuple[tuple[str, ...], Floats, Floats]:
    """Return names, values and standard errors (m,) of the parameters that were known or found."""
    read, q, covariance = ParameterReader(search, fitted), fitted.solution.q, _covariance(search, fitted)
    found = read(q)
    names, theta = tuple(found), np.array(list(found.values()))
    width = np.nan_to_num(np.sqrt(np.abs(np.diag(covariance))), nan=1.0, posinf=1.0)
    std = _spread(_gradient(read, q, width), covariance)
    if "delay" in found:  # a goal waits for the next tick of the loop
        std[names.index("delay")] = math.hypot(std[names.index("delay")], search.task.servo.loop_period / math.sqrt(12))
    if "coulomb" in found:
        std[names.index("coulomb")] = math.hypot(std[names.index("coulomb")], _measure_rests(search, fitted))
    std = np.where(np.isfinite(std) & (std > 0), std, np.inf)
    return names, theta, np.maximum(std, TUNING.least_error * np.abs(theta))


def _measure_rests(search: ServoSearch, fitted: Fitted) -> float:
    """Return the standard error of the Coulomb friction [N m] by the counts in the loop.

    At each turn or rest, the count that the loop sees differs from the position by a rounding, which acts as friction.
    """
    problem, turns = fitted.problem, 1
    for _, v in problem.motion(fitted.solution.q, fitted.solution.starts):
        turns += int(np.sum(np.diff(np.sign(v)) != 0))
    body, _, _ = problem._body(fitted.solution.q, problem.stretches[0].acts)
    return float(body[-problem.machine.loops]) * problem.resolution / math.sqrt(12 * turns)


def _covariance(search: ServoSearch, fitted: Fitted) -> Floats:
    """Return the covariance (p, p) of the coordinates, with the spread over models that the logs do not exclude."""
    covariance = _scatter(search, fitted)
    std, wide = np.sqrt(np.diag(covariance)), np.ones(len(covariance))
    half = fitted.half.copy()
    half[search.plain.machine.lead] /= fitted.theta[search.plain.machine.lead]
    wide[: search.count] = np.maximum(half / TUNING.normal / np.maximum(std[: search.count], 1e-300), 1.0)
    return np.asarray(covariance * np.outer(wide, wide))


def _scatter(search: ServoSearch, fitted: Fitted) -> Floats:
    """Return the covariance (p, p) of the coordinates in the chosen model, infinite where the logs say nothing."""
    normal = fitted.solution.normal
    A = normal.A + np.diag(search.prior(search.problem))
    known = np.diag(A) > 0
    blocks = [ResidualBlock(block.e, block.J[:, known], block.K) for block in normal.blocks]
    inner = [part[:, np.append(True, known)] for part in normal.inner]
    part = A[np.ix_(known, known)]
    covariance = np.diag(np.where(known, 0.0, np.inf))
    covariance[np.ix_(known, known)] = sandwich(part, replace(normal, blocks=blocks, inner=inner))
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
