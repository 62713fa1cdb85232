"""Trials of one further term, including periodic forces."""

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
    """A model at its best fit to a record.

    `log_likelihood` is the log-likelihood of the counts in natural units.
    """

    model: Drive
    method: IntervalML
    best: Best
    log_likelihood: float

    @property
    def difference(self) -> Difference:
        return self.best.difference

    @property
    def theta(self) -> Floats:
        """The parameters (p,) of the equation, followed by the parameters of its shapes."""
        return np.asarray((self.best.q * self.difference.scale)[: self.difference.parameters])

    @property
    def parameters(self) -> int:
        return self.difference.parameters

    def weigh_forces(self, places: Sequence[PeriodicForce] = ()) -> Adequacy:
        return weigh(self.best, places)

    @property
    def usual_speed(self) -> float:
        """The root mean square velocity of the simulated motion."""
        velocity = self.difference.motion(self.best.q)[1]
        return rms(velocity[velocity != 0])


def inflation(before: Trial, after: Trial) -> float:
    """Return the factor by which dependent errors increase the likelihood ratio.

    The factor is the scatter of the scores of the new terms, divided by the scatter for independent errors. The
    function returns the largest ratio over all new directions.
    """
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
    """Return the same motion from an equation whose shape parameters are known."""
    difference, q = best.difference, best.q
    p = len(difference.equation.names)
    equation = difference.equation.known_at((q * difference.scale)[p : difference.parameters])
    keep = np.r_[0:p, difference.parameters : q.size]
    linear = difference.replace_equation(equation, difference.scale[:p])
    return replace(best, difference=linear, least=best.least[keep], q=q[keep])


def carry_parameters(before: Equation, theta: Floats, after: Equation) -> Floats:
    """Return the parameters (p,) of one equation as start values of another equation.

    If only the new equation has a parameter, its start value is zero.
    """
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


#: Distances from a peak, in pitches, at which the scan is refined.
CLOSER = np.arange(-0.4, 0.5, 0.1)


def pitches(best: Best) -> Floats:
    """Return the possible numbers of pitches of a cogging force in the travel (k,).

    The array is empty if the travel is too short for any pitch.
    """
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
    """Return the numbers of pitches of a cogging force in the travel at the peaks of all scans.

    The scans start at a model's best fit to u (n,) and counts (n,).
    """
    numbers = pitches(best)
    if not numbers.size:
        return []
    found = list(_peaks(numbers, lambda tried: _predict_gains(best, tried)))
    for part in TUNING.term_trials_slower:
        own = like(LS, method, model=method.model.simple, cutoff=part * method.cutoff)
        found += _peaks(numbers, lambda tried, own=own: scan_balance(own, u, counts, tried))  # type: ignore[misc]
    return drop_neighbours(found)


def _peaks(numbers: Floats, gain_of: Callable[[Floats], Floats]) -> Iterator[float]:
    """Yield the largest peaks of the gain, each refined on a finer grid."""
    gain = gain_of(numbers)
    for _ in range(TUNING.term_trials_peaks):
        k = int(np.argmax(gain))
        if not gain[k] > 0:
            return
        near = numbers[k] + CLOSER
        yield float(near[int(np.argmax(gain_of(near)))])
        gain[np.abs(numbers - numbers[k]) < TUNING.term_trials_between] = 0.0


def drop_neighbours(numbers: Sequence[float]) -> list[float]:
    """Return the numbers without those close to an earlier number."""
    kept = list[float]()
    for number in numbers:
        if all(abs(number - other) > TUNING.term_trials_apart for other in kept):
            kept.append(number)
    return kept


def _predict_gains(best: Best, numbers: Floats) -> Floats:
    """Return the doubled gain of the log-likelihood (k,) that scores predict for each number of pitches in the travel.

    The gain is approximate and comes from the scores of sine and cosine together.
    """
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
    """Return the part (k,) of the residual that a periodic force explains, for each number of pitches in the travel.

    The residual is that of a filtered force balance, from u (n,) and counts (n,). The periodic force acts at the
    measured position. The function first removes the effect of the model's own terms.
    """
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
    """Mark the samples (n,) where the axis moves within `near` samples. At rest, friction balances any force."""
    moves = np.diff(counts, append=counts[-1]) != 0
    return np.asarray(np.convolve(moves, np.ones(2 * near + 1), "same") > 0)


@dataclass(frozen=True)
class Pitched(Difference):
    """A `Difference` whose unknowns q include the pitch of the cogging force.

    The unknowns are q = (theta, x0, v0, number / term_trials_hundred), where `number` counts the pitches in the travel.
    `model` has the equation at any pitch.
    """

    model: Drive | None = None

    def fix_pitch(self, q: Floats) -> Difference:
        """Return the difference with the pitch fixed at its value in q (q + 1,)."""
        own = {field.name: getattr(self, field.name) for field in fields(Difference)}
        return Difference(**(own | {"equation": self.model_at(q).equation}))

    def model_at(self, q: Floats) -> Drive:
        """Return the model with the pitch in q (q + 1,)."""
        if self.model is None:
            raise TypeError("a difference with an unknown pitch needs the model of the cogging force: pass model")
        return change_arguments(self.model, {"cogging": float(np.ptp(self.y) / (TUNING.term_trials_hundred * q[-1]))})

    @property
    def number(self) -> float:
        """The number of pitches of the model's cogging force in the travel."""
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
    """Return the difference of a model with a cogging force, with the pitch as a further unknown."""
    own = {field.name: getattr(difference, field.name) for field in fields(Difference)}
    return Pitched(**own, model=model)
