"""Trials of one more term, and of forces with a period."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.tuning import TUNING
from pmfid.estimators.adequacy import Adequacy, PeriodicForce, filter_forces, information_of, score_variance, weigh
from pmfid.estimators.configuration import change_arguments, like
from pmfid.estimators.likelihood import Best
from pmfid.estimators.ls import LS
from pmfid.estimators.motion import Difference, rms
from pmfid.estimators.output_error import IntervalML
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.models.drive import Drive
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    OFFSET,
    ROLES,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
    Equation,
)
from pmfid.types import Floats


@dataclass(frozen=True)
class Trial:
    """A model at its best fit to a record. log_likelihood: of the counts, in natural units; places: what may come again
    along the travel, to look for."""

    model: Drive
    method: IntervalML
    best: Best
    log_likelihood: float

    @property
    def difference(self) -> Difference:
        return self.best.difference

    @property
    def theta(self) -> Floats:
        """(p,) parameters of the equation, followed by those that it is not linear in."""
        return np.asarray((self.best.q * self.difference.scale)[: self.difference.parameters])

    @property
    def parameters(self) -> int:
        return self.difference.parameters

    def weigh_forces(self, places: Sequence[PeriodicForce] = ()) -> Adequacy:
        return weigh(self.best, places)

    @property
    def usual_speed(self) -> float:
        """Root mean square velocity of the simulated motion."""
        velocity = self.difference.motion(self.best.q)[1]
        return rms(velocity[velocity != 0])


def inflation(before: Trial, after: Trial) -> float:
    """Ratio of the scatter of the scores of a model's new terms, at its fit, to the scatter of independent errors.
    Chance inflates likelihood ratios by this factor. The largest over all new directions."""
    best, old, new = after.best, before.model.equation, after.model.equation
    difference, p = best.difference, best.difference.parameters
    sensitivity = -difference.jacobian(best.q)
    own = difference.remove_nuisance(sensitivity[:, :p], sensitivity[:, p:]) / difference.scale[:p]
    steps = TUNING.term_trials_small * np.maximum(
        np.abs(before.theta), TUNING.term_trials_small * float(np.max(np.abs(before.theta)))
    )
    begin = carry_parameters(old, before.theta, new)
    moves = [(carry_parameters(old, before.theta + step, new) - begin) / float(np.sum(step)) for step in np.diag(steps)]
    shared = own @ np.column_stack(moves)
    shared /= np.maximum(np.linalg.norm(shared, axis=0), ESTIMATOR_TUNING.tiny)
    own /= np.maximum(np.linalg.norm(own, axis=0), ESTIMATOR_TUNING.tiny)
    alone = own - shared @ np.linalg.lstsq(shared, own)[0]
    directions = np.linalg.svd(alone, full_matrices=False)[0][:, : max(1, p - len(moves))]
    information, slope = information_of(best)
    return float(np.max(score_variance(best, directions, information, slope)) / information)


def known_shapes(best: Best) -> Best:
    """The same motion, from an equation whose shape parameters are known."""
    difference, q = best.difference, best.q
    p = len(difference.equation.names)
    equation = difference.equation.known_at((q * difference.scale)[p : difference.parameters])
    keep = np.r_[0:p, difference.parameters : q.size]
    linear = difference.replace_equation(equation, difference.scale[:p])
    return replace(best, difference=linear, least=best.least[keep], q=q[keep])


def carry_parameters(before: Equation, theta: Floats, after: Equation) -> Floats:
    """Parameters (p,) of one equation as start values of another; parameters that only the latter has are zero."""
    own = before.role_values(theta)
    body, further = (
        own[: len(ROLES)],
        dict(zip([n for n, _ in before.further], theta[len(before.names) :], strict=True)),
    )
    offset = body[OFFSET]
    found = np.zeros(len(after.names))
    if after.roles[OFFSET] is None:
        body[COULOMB_FORWARD] += offset
        body[COULOMB_BACKWARD] -= offset
    elif before.roles[OFFSET] is None:
        body[OFFSET] = (body[COULOMB_FORWARD] - body[COULOMB_BACKWARD]) / 2
    for forward, backward in ((VISCOUS_FORWARD, VISCOUS_BACKWARD), (COULOMB_FORWARD, COULOMB_BACKWARD)):
        if after.roles[forward] == after.roles[backward]:
            body[forward] = body[backward] = (body[forward] + body[backward]) / 2
    for value, index in zip(body, after.roles, strict=False):
        if index is not None:
            found[index] = value
    sizes = dict(zip(before.names, theta, strict=False))
    for index, term in enumerate(after.unknown):
        if term.shape is not None:
            found[index] = sizes.get(str(term.name), 0.0)
    found = np.where(after.positive, np.maximum(found, 0.0), found)
    return np.asarray(np.r_[found, [further.get(name, 0.0) for name, _ in after.further]])


#: Around a peak they are tried this much apart.
CLOSER = np.arange(-0.4, 0.5, 0.1)


def pitches(best: Best) -> Floats:
    """(k,) how many pitches of a cogging force the travel may have; none where it is too short for any."""
    difference = replace(best.difference, parts=1)
    travel, v = float(np.ptp(difference.y)), difference.motion(best.q)[1]
    usual = rms(v[v != 0]) if np.any(v) else 0.0
    shortest = max(
        TUNING.term_trials_counts * difference.resolution, TUNING.term_trials_samples * usual * difference.dt
    )
    return np.arange(
        TUNING.term_trials_fewest,
        min(TUNING.term_trials_most, travel / max(shortest, 1e-300)),
        TUNING.term_trials_apart,
    )


def candidates(method: IntervalML, u: Floats, counts: NDArray[np.int64], best: Best) -> list[float]:
    """How many pitches of a cogging force the travel may have by the peaks of the scans, at a model's best fit to u,
    counts (n,)."""
    numbers = pitches(best)
    if not numbers.size:
        return []
    found = list(_peaks(numbers, lambda tried: _predict_gains(best, tried)))
    for part in TUNING.term_trials_slower:
        own = like(LS, method, model=method.model.simple, cutoff=part * method.cutoff)
        found += _peaks(numbers, lambda tried, own=own: scan_balance(own, u, counts, tried))  # type: ignore[misc]
    return drop_neighbours(found)


def _peaks(numbers: Floats, gain_of: Callable[[Floats], Floats]) -> Iterator[float]:
    """The largest, each looked at more closely."""
    gain = gain_of(numbers)
    for _ in range(TUNING.term_trials_peaks):
        k = int(np.argmax(gain))
        if not gain[k] > 0:
            return
        near = numbers[k] + CLOSER
        yield float(near[int(np.argmax(gain_of(near)))])
        gain[np.abs(numbers - numbers[k]) < TUNING.term_trials_between] = 0.0


def drop_neighbours(numbers: Sequence[float]) -> list[float]:
    """The numbers without those close to an earlier one."""
    kept = list[float]()
    for number in numbers:
        if all(abs(number - other) > TUNING.term_trials_apart for other in kept):
            kept.append(number)
    return kept


def _predict_gains(best: Best, numbers: Floats) -> Floats:
    """(k,) doubled gain of the log-likelihood that the scores of sin and cos together promise, about, for each number
    of pitches in the travel."""
    coarse = replace(best, difference=replace(best.difference, parts=1))
    travel, gains = float(np.ptp(best.difference.y)), dict.fromkeys(numbers.tolist(), 0.0)
    for part in _parts(numbers):
        own = {travel / number: number for number in part.tolist()}
        found = weigh(coarse, [PeriodicForce("cogging", period) for period in own])
        for candidate, gain in zip(found.forces, found.gain.tolist(), strict=True):
            if candidate.name == "cogging":
                gains[own[float(candidate.changes[0]["cogging"])]] += gain  # type: ignore[arg-type]
    return np.array(list(gains.values()))


def _parts(numbers: Floats) -> list[Floats]:
    return [numbers[first : first + TUNING.at_a_time] for first in range(0, numbers.size, TUNING.at_a_time)]


def scan_balance(method: LS, u: Floats, counts: NDArray[np.int64], numbers: Floats) -> Floats:
    """(k,) part of the residual of a filtered balance of forces that a periodic force at the measured position
    explains, for each number of pitches in the travel. u, counts: (n,). The model's own terms are taken out first."""
    columns, y = method.columns(u, counts), method.encoder.resolution * (counts - counts[0])
    middle = y + np.diff(y, append=y[-1]) / 2
    own = np.linalg.qr(columns.phi)[0]
    left, near = columns.z - own @ (own.T @ columns.z), math.ceil(1 / (method.cutoff * method.dt))
    moving = _moving(counts, near)
    found = []
    for part in _parts(numbers):
        angle = np.outer(2 * np.pi / np.ptp(y) * part, middle)
        waves = filter_forces(moving * np.concatenate([np.sin(angle), np.cos(angle)]), method)[:, columns.used]
        waves -= (waves @ own) @ own.T
        sin, cos = waves[: part.size], waves[part.size :]
        a, b, both = np.sum(sin**2, axis=1), np.sum(cos**2, axis=1), np.sum(sin * cos, axis=1)
        ours, its = sin @ left, cos @ left
        found.append((b * ours**2 - 2 * both * ours * its + a * its**2) / np.maximum(a * b - both**2, 1e-9 * a * b))
    return np.asarray(np.concatenate(found) / float(left @ left))


def _moving(counts: NDArray[np.int64], near: int) -> NDArray[np.bool_]:
    """(n,) does the axis move within `near` samples? At rest friction takes up any force."""
    moves = np.diff(counts, append=counts[-1]) != 0
    return np.asarray(np.convolve(moves, np.ones(2 * near + 1), "same") > 0)


@dataclass(frozen=True)
class Pitched(Difference):
    """A `Difference` as a function of q = (theta, x0, v0, number / term_trials_hundred) as well: how many pitches of
    the cogging force the travel has. model: of the equation, at any pitch."""

    model: Drive | None = None

    def fix_pitch(self, q: Floats) -> Difference:
        """The difference with the pitch fixed at that of q (q + 1,)."""
        own = {field.name: getattr(self, field.name) for field in fields(Difference)}
        return Difference(**(own | {"equation": self.model_at(q).equation}))

    def model_at(self, q: Floats) -> Drive:
        """The model at the pitch of q (q + 1,)."""
        if self.model is None:
            raise TypeError("a difference with a pitch needs the model that has it")
        return change_arguments(self.model, {"cogging": float(np.ptp(self.y) / (TUNING.term_trials_hundred * q[-1]))})

    @property
    def number(self) -> float:
        """How many pitches of the model's own cogging force the travel has."""
        return float(np.ptp(self.y)) / float((self.model and self.model.cogging) or np.nan)

    def differences(self, qs: Floats) -> Floats:
        found, pitches = np.empty((len(qs), self.y.size)), qs[:, -1]
        for pitch in np.unique(pitches):
            rows = pitches == pitch
            found[rows] = self.fix_pitch(qs[rows][0]).differences(qs[rows, :-1])
        return found

    @property
    def lower(self) -> Floats:
        return np.asarray(np.r_[super().lower, TUNING.term_trials_fewest / 2 / TUNING.term_trials_hundred])


def free_pitch(difference: Difference, model: Drive) -> Pitched:
    """The difference of a model with a cogging force, with the pitch as a further unknown."""
    own = {field.name: getattr(difference, field.name) for field in fields(Difference)}
    return Pitched(**own, model=model)
