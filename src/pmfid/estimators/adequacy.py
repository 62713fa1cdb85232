"""Adequacy of a model: score tests against candidate forces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid._stage import first_order
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.least_squares import solve_with_instruments
from pmfid.estimators.likelihood import Best, cost, expected_information
from pmfid.estimators.motion import Difference, rms
from pmfid.estimators.output_error import IntervalML
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.tuning import TUNING
from pmfid.estimators.uncertainty import block_scatter, phase_scatter, sparse_phase_slopes
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    LATE,
    MASS,
    OFFSET,
    STIFFNESS,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
)
from pmfid.models.shapes import ESTIMATE, Square, Stribeck, Wave
from pmfid.types import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Keys of [model] and the values to set.
Change = Mapping[str, object]
DIRECTIONAL: Change = {"friction": "directional", "offset": False}
ACTING = "use the input that acts on the plant, as [record] input"


@dataclass(frozen=True)
class CandidateForce:
    """A candidate for a force that the model leaves out.

    `says` describes the force for people, and `cure` is the remedy. `force` is the force against the motion per unit of
    its coefficient, (n,), or (k n,) for k equal parts of every sample. `plausible` is the coefficient that a machine
    may have. If `plausible` is 0, the force is tested, but not assumed to exist. `changes` are changes of [model], each
    of which adds the force. `positive` is True if no machine has a negative coefficient.
    """

    name: str
    says: str
    cure: str
    force: Floats
    plausible: float
    changes: tuple[Change, ...] = field(default=(), kw_only=True)
    positive: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class PeriodicForce:
    """A force or a friction that is periodic in the position: its key in [model], and its period in the unit of y."""

    key: str
    period: float

    @property
    def says(self) -> str:
        what = {
            "gravity": "gravity, or a load out of balance,",
            "cogging": "a cogging force",
            "friction_period": "friction",
        }
        return f"{what[self.key]} with a period of {self.period:.4g} of the travel"

    def forces(self, x: Floats, v: Floats) -> Iterator[Floats]:
        """Yield the force (n,) along the motion for a unit of the sine and for a unit of the cosine."""
        side = np.sign(v) if self.key == "friction_period" else 1.0
        for wave in (Wave(self.period), Wave(self.period, True)):
            yield np.asarray(side * wave.evaluate(x))


def list_candidate_forces(
    difference: Difference, q: Floats, places: Sequence[PeriodicForce] = ()
) -> list[CandidateForce]:
    """Return the forces that may be missing along the motion simulated at q (q,). `places` are forces periodic in
    the position.
    """
    x, v = difference.motion(q)
    moving = v != 0
    if not np.any(moving):
        return []
    found = chain(_frictions(difference, q, v), _forces(difference, q, x, v), _places(difference, places, v))
    if v.size <= TUNING.stretch:
        return list(found)
    return [replace(one, force=one.force.astype(np.float32)) for one in found]  # of a long record these take 200 MB


def _frictions(difference: Difference, q: Floats, v: Floats) -> Iterator[CandidateForce]:
    values = difference.equation.role_values(q * difference.scale)
    speed, side, usual = np.abs(v), np.sign(v), rms(v[v != 0])
    coulomb = max(
        (values[COULOMB_FORWARD] + values[COULOMB_BACKWARD]) / 2,
        TUNING.least_friction * abs(difference.equation.input_gain) * rms(difference.u),
    )
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2 * usual
    known = [term.shape for term in difference.equation.shaped if term.signal == "friction"]
    for part in () if any(isinstance(shape, Stribeck) for shape in known) else TUNING.stribeck_speeds:
        says = "friction that is larger at low speed (Stribeck)"
        change: Change = {"stribeck": ESTIMATE}
        force = _stribeck(difference, q, v, part * usual)
        yield CandidateForce(
            "stribeck", says, _cure(change), force, TUNING.adequacy_stribeck * coulomb, changes=(change,), positive=True
        )
    if not any(isinstance(shape, Square) for shape in known):
        says, change = "friction that is not linear at high speed", {"quadratic": True}
        force = v * speed / usual**2
        yield CandidateForce(
            "curved", says, _cure(change), force, TUNING.adequacy_curved * viscous, changes=(change,), positive=True
        )
    yield CandidateForce(
        "drifting", "friction that changes over the record", "", side * np.linspace(-1, 1, v.size), 0.0
    )
    roles = difference.equation.roles
    if roles[COULOMB_FORWARD] == roles[COULOMB_BACKWARD]:
        cure = 'set friction = "directional" in [model]' + ("" if roles[OFFSET] is None else " in place of offset")
        says = "viscous friction that differs with the direction"
        yield CandidateForce(
            "uneven", says, cure, speed / usual, TUNING.adequacy_uneven * viscous, changes=(DIRECTIONAL,)
        )
        if roles[OFFSET] is None:
            cure += ", or offset = true for a constant load"
            says = "a constant load, or Coulomb friction that differs with the direction"
            changes = ({"offset": True}, DIRECTIONAL)
            yield CandidateForce("load", says, cure, np.abs(side), TUNING.adequacy_uneven * coulomb, changes=changes)


def _cure(change: Change) -> str:
    return f"set {' and '.join(setting(*pair) for pair in change.items())} in [model]"


def setting(key: str, value: object) -> str:
    """Return one line of the table [model]."""
    if isinstance(value, bool):
        return f"{key} = {'true' if value else 'false'}"
    return f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value:.9g}"


def _stribeck(difference: Difference, q: Floats, v: Floats, fall: float) -> Floats:
    """Return exp(-(v / fall)^2) against the motion (k n,), as its mean over each of the k parts of every sample.

    The velocity changes linearly from one part to the next.
    """
    change = float(np.max(np.abs(np.diff(v)), initial=0.0))
    most = TUNING.most_parts if v.size <= TUNING.stretch else TUNING.stretch_parts
    parts = int(np.clip(np.ceil(change / (TUNING.adequacy_fine * fall)), 1, most))
    v = difference.motion(q, np.zeros(parts * v.size))[1]
    ends = np.r_[v[0], (v[1:] + v[:-1]) / 2, v[-1]]
    erf = np.fromiter(map(math.erf, np.abs(ends) / fall), np.float64, ends.size)  # SciPy is slow to import
    below = np.diff(fall * np.sqrt(np.pi) / 2 * erf)
    step = np.diff(ends)
    steady = np.abs(step) < TUNING.adequacy_steady * fall
    return np.where(steady, np.sign(v) * np.exp(-((v / fall) ** 2)), below / np.where(steady, 1.0, step))


def _forces(difference: Difference, q: Floats, x: Floats, v: Floats) -> Iterator[CandidateForce]:
    gain, u, roles = difference.equation.input_gain, difference.u, difference.equation.roles
    late = gain * np.diff(u, prepend=u[0]) / difference.intervals
    if roles[LATE] is None:
        change: Change = {"dead_time": ESTIMATE}
        says, known = "a dead time or a lag of the input", difference.equation.dead_time
        yield CandidateForce(
            "dead_time",
            says,
            _cure(change),
            late,
            TUNING.late_by * difference.dt,
            changes=(change,),
            positive=not known,
        )
    place = (x - np.mean(x)) / max(float(np.ptp(x)), np.finfo(float).tiny)
    along = {term.signal for term in difference.equation.shaped if term.shape and not term.shape.of_speed}
    if "friction" not in along:
        yield CandidateForce("uneven_way", "friction that differs along the travel", "", np.sign(v) * place, 0.0)
    if "place" not in along and roles[STIFFNESS] is None:
        change = {"spring": True}
        yield CandidateForce(
            "spring", "a force that grows with the position", _cure(change), place, 0.0, changes=(change,)
        )
    yield CandidateForce(
        "bent_input", "a force that is not proportional to the input", "", -gain * u * np.abs(u) / rms(u), 0.0
    )
    largest = float(np.max(np.abs(u)))
    for part in TUNING.adequacy_kinks:
        less = gain * np.sign(u) * np.maximum(np.abs(u) - part * largest, 0.0)
        yield CandidateForce(
            "saturated_input", "an input whose largest values act too weakly", ACTING, less, 0.0, positive=True
        )
    zone, most = gain * np.sign(u), TUNING.dead_zone * largest
    yield CandidateForce("dead_zone", "a dead zone of the input", ACTING, zone, most)
    if difference.equation.roles[MASS] is not None:
        acceleration = np.diff(v, append=v[-1]) / difference.intervals
        yield CandidateForce(
            "changing", "a mass that changes over the record", "", acceleration * np.linspace(-1, 1, v.size), 0.0
        )


def _places(difference: Difference, places: Sequence[PeriodicForce], v: Floats) -> Iterator[CandidateForce]:
    """Yield the periodic forces at the measured positions. The simulated motion may deviate by more than a period."""
    middle = difference.y - difference.slack
    middle = middle + np.diff(middle, append=middle[-1]) / 2
    for place in places:
        change: Change = {place.key: place.period}
        for force in place.forces(middle, v):
            yield CandidateForce(place.key, place.says, _cure(change), force, 0.0, changes=(change,))


@dataclass(frozen=True)
class Adequacy:
    """Result of the score tests: evidence of the counts against the model, at the model's best fit.

    `difference` and `q` are the fit. `noise` is the standard deviation [counts] in addition to the encoder's step if
    the fit is within the counts, else None. `forces` are k candidates, and `z` (k,) are their scores in standard
    deviations. `size` and `size_std` (k,) are the coefficients that the counts ask for, to first order, with their
    standard deviations. `expected` (k,) is the information on each coefficient. `moves` (p, k) is the shift of the
    fit's parameters for a unit of each force. `elsewhere` (k,) is the doubled gain of the log-likelihood over parts of
    the record, each with the coefficient from the other parts. `unseen` (p,) is the shift of the parameters by
    plausible forces that no record with this input shows. For example, a dead zone looks like an error of the gain if
    the input has only one size. `explained` is the share (root mean square) of the residual beyond the encoder's error
    that the best force explains.
    """

    difference: Difference
    q: Floats
    noise: float | None
    forces: tuple[CandidateForce, ...]
    z: Floats
    size: Floats
    size_std: Floats
    expected: Floats
    moves: Floats
    elsewhere: Floats
    unseen: Floats
    explained: float

    @property
    def follows(self) -> bool:
        """True if the fit is within the counts."""
        return self.noise is not None

    @property
    def adequate(self) -> bool:
        """True if no test shows that the model is wrong."""
        return self.follows and not self.missed

    @cached_property
    def missed(self) -> tuple[int, ...]:
        """Indices of the forces that the counts ask for, in descending order of `gain`."""
        return tuple(int(k) for k in np.argsort(-self.gain) if abs(self.z[k]) > TUNING.adequacy_missed)

    @property
    def named(self) -> tuple[int, ...]:
        """Indices of the missed forces that explain nearly as much as the best one. Each named force may be the
        unmodelled effect.
        """
        return tuple(k for k in self.missed if self.gain[k] > TUNING.adequacy_nearly * self.gain[self.missed[0]])

    @cached_property
    def gain(self) -> Floats:
        """Doubled improvement of the log-likelihood (k,) by each force alone, to first order.

        A force may have a high score and still explain little of the residual, while another force explains all of it.
        """
        return np.asarray(self.size**2 * self.expected)

    @property
    def dead_time(self) -> float | None:
        """Dead time [s] of the input that the counts ask for, to first order; None if no dead time is among `named`."""
        found = [k for k in self.named if self.forces[k].name == "dead_time" and self.size[k] > 0]
        return float(self.size[found[0]]) if found else None

    @property
    def left(self) -> float:
        """Share of the motion, 0 to about 1, that neither the model nor the encoder explains."""
        return self.difference.measure_misfit(self.q)

    @property
    def described(self) -> tuple[str, ...]:
        """Descriptions for people of the forces that the motion asks for, the most important first."""
        asked = (self._describe_force(k) for k in self.named) if self.missed else ()
        return tuple(dict.fromkeys(asked))[: TUNING.most_said]

    @property
    def cure(self) -> str:
        """Remedy for the most important missed force; empty if no force is missed."""
        if not self.missed:
            return ""
        first = self.missed[0]
        return "shift the input's column earlier by that time" if self._is_early(first) else self.forces[first].cure

    def _is_early(self, k: int) -> bool:
        """Return whether force k stands for a negative dead time of a model without a dead time."""
        none = self.difference.equation.dead_time == 0
        return bool(none and self.forces[k].name == "dead_time" and self.size[k] < 0)

    def _describe_force(self, k: int) -> str:
        candidate = self.forces[k]
        if self._is_early(k):
            return f"an input that acts about {-self.size[k]:.2g} s too early"
        return f"{candidate.says} of about {self.size[k]:.2g} s" if candidate.name == "dead_time" else candidate.says

    @cached_property
    def tolerated(self) -> Floats:
        """Root mean square coefficients (k,) that are plausible in a machine and that the counts do not exclude.

        Each coefficient has a Gaussian prior with the standard deviation `plausible`.
        """
        prior = np.array([candidate.plausible for candidate in self.forces]) ** 2
        share = prior / (prior + self.size_std**2)
        return np.asarray(np.sqrt(share * self.size_std**2 + (share * self.size) ** 2))

    def spread(self, moves: Floats | None = None) -> Floats:
        """Return the shift (p,) of the parameters by the forces that the record tolerates.

        `moves` (p, k) are the shifts of another method's estimate per unit of each force. None takes the shifts of the
        best fit.
        """
        moves = self.moves if moves is None else moves
        return np.asarray(np.sqrt(np.sum((moves * self.tolerated) ** 2, axis=1)))


def examine(estimator: Estimator, u: ArrayLike, counts: ArrayLike, start: Floats | None = None) -> Adequacy:
    """Test the model of an estimator on a record u, counts: (n,).

    Of the estimator's settings, only the cutoff matters, for records that drift away from the simulation. `start` (p,)
    are the start values; None takes the estimate of `IV`. Raises NotIdentifiableError if no fit exists.
    """
    method = like(IntervalML, estimator, prefilter_zeros=None, precision="float64", drift_cutoff=None)
    return weigh(method.best(u, counts, start))


def weigh(best: Best, places: Sequence[PeriodicForce] = ()) -> Adequacy:
    """Test the model at the motion that fits best. `places` are additional candidates, periodic in the position."""
    return _run_score_tests(best, *information_of(best), places)


def information_of(best: Best) -> tuple[float, Floats]:
    """Return the information of a sample [1/counts^2] and the slopes (n,) of the negative log-likelihood with
    respect to the difference.
    """
    error = best.difference(best.q)
    if best.noise is None:
        information = 1 / max(float(np.mean(error**2)), 1 / 12)
        return information, error * information
    return mean_information(best.noise), cost(error, best.noise)[1]


def score_variance(
    best: Best, effects: Floats, information: float, slope: Floats, phases: csr_array | None = None
) -> Floats:
    """Return the variances (k,) of the scores of effects (n, k) [counts].

    Each variance is the largest of three: the variance for independent samples, the scatter over blocks, and the
    scatter over positions of the encoder's lattice. `phases` are the scores at these positions if they are known.
    """
    difference, expected = best.difference, np.sum(effects**2, axis=0) * information
    variance = np.maximum(expected, block_scatter(effects * slope[:, None], difference.recovery))
    if best.noise is not None:
        variance = np.maximum(variance, phase_scatter(difference, best.q, effects, best.noise, phases))
    return np.asarray(variance)


def mean_information(noise: float) -> float:
    """Return the information of a count on the position [1/counts^2], as the mean over all positions within the
    count.
    """
    return float(np.mean(expected_information(np.linspace(-0.5, 0.5, 1001), noise)))


def _run_score_tests(best: Best, information: float, slope: Floats, places: Sequence[PeriodicForce]) -> Adequacy:
    """Run the score tests.

    `information` is the information of a sample, and `slope` (n,) the slope of the negative log-likelihood with respect
    to the difference.
    """
    difference, q = best.difference, best.q
    p = difference.parameters
    sensitivity = -difference.jacobian(q)
    own = difference.remove_nuisance(sensitivity[:, :p], sensitivity[:, p:])
    candidates = list_candidate_forces(difference, q, places)
    batches = list(_batches(candidates, difference.rows))
    phases = None
    if best.noise is not None and best.clean and len(batches) > 1:
        phases = sparse_phase_slopes(difference, q, best.noise)
    tests = [_test_forces(best, own, sensitivity[:, p:], batch, information, slope, phases) for batch in batches]
    apart, hidden, moves, score, expected, variance, alone, elsewhere = (
        np.concatenate(parts, axis=-1) for parts in zip(*tests, strict=True)
    )
    if best.noise is None and not np.any(np.abs(score) > TUNING.adequacy_missed * np.sqrt(variance)):
        variance = alone
    z, size, std = score / np.sqrt(variance), score / expected, np.sqrt(variance) / expected
    found = tuple(candidate for candidate, there in zip(chain(*batches), apart, strict=True) if there)
    unseen = np.linalg.norm(hidden, axis=1)
    of_encoder = slope.size * (1.0 if best.noise is not None else information / 12)
    wrong = max(float(slope @ slope) / information - of_encoder, TUNING.tiny)
    explained = min(float(np.sqrt(np.max(size**2 * expected, initial=0.0) / wrong)), 1.0)
    return Adequacy(difference, q, best.noise, found, z, size, std, expected, moves, elsewhere, unseen, explained)


def _batches(candidates: list[CandidateForce], rows: int) -> Iterator[list[CandidateForce]]:
    """Yield the forces that are tested at once: all of them, or those of a long record with bounded memory."""
    if rows <= TUNING.stretch:
        yield candidates
        return
    for size in dict.fromkeys(candidate.force.size for candidate in candidates):
        alike, most = [one for one in candidates if one.force.size == size], max(1, _PAIRS * rows // size)
        yield from (alike[k : k + most] for k in range(0, len(alike), most))


def _test_forces(
    best: Best,
    own: Floats,
    nuisance: Floats,
    candidates: list[CandidateForce],
    information: float,
    slope: Floats,
    phases: csr_array | None,
) -> tuple[NDArray[np.bool_], Floats, Floats, Floats, Floats, Floats, Floats, Floats]:
    """Test k forces at the sensitivities `own` (n, p) to the parameters and `nuisance` (n, 2) to the start.

    Returns a mark (k,) for each force whose effect is apart from that of the parameters, and the shift (p, h) of the
    parameters by the others. For each marked force follow the shift of the parameters (p, m), score, information and
    variance (m,), the variance if the force alone were missing, and `gain_elsewhere`.
    """
    difference, p = best.difference, best.difference.parameters
    effects = _effects(difference, best.q, candidates)
    effects[:, ~np.all(np.isfinite(effects), axis=0)] = 0.0  # a force of almost 0 may overflow
    cleaned = difference.remove_nuisance(effects, nuisance)
    del effects  # of long records each of these takes some 100 MB
    scale = np.maximum(np.linalg.norm(own, axis=0), TUNING.tiny)
    shift = np.linalg.lstsq(own / scale, cleaned)[0] / scale[:, None]
    before, alone = np.linalg.norm(cleaned, axis=0), cleaned
    alone -= own @ shift
    apart = np.linalg.norm(alone, axis=0) > TUNING.adequacy_apart * before
    moves = -shift * difference.scale[:p, None]
    hidden = moves[:, ~apart] * np.array([candidate.plausible for candidate in candidates])[~apart]
    alone, moves = alone if np.all(apart) else alone[:, apart], moves[:, apart]
    score, expected = alone.T @ slope, np.sum(alone**2, axis=0) * information
    variance = score_variance(best, alone, information, slope, phases)
    without = variance
    if best.noise is None and not np.any(np.abs(score) > TUNING.adequacy_missed * np.sqrt(variance)):
        # If a missing force is large, its residual hides the force. The variance then comes from the residual that each
        # force leaves.
        left = slope[:, None] - information * alone * (score / expected)
        without = np.minimum(variance, np.maximum(expected, block_scatter(alone * left, difference.recovery)))
    elsewhere = gain_elsewhere(alone * slope[:, None], alone**2 * information)
    return apart, hidden, moves, score, expected, variance, without, elsewhere


def gain_elsewhere(scores: Floats, informations: Floats) -> Floats:
    """Return the doubled gain of the log-likelihood (k,) over adequacy_parts parts of the samples, to first order.

    The coefficient in each part comes from the other parts. `scores` and `informations` (n, k) are those of the samples
    on each coefficient.
    """
    parts = [
        np.array([part.sum(axis=0) for part in np.array_split(a, TUNING.adequacy_parts)])
        for a in (scores, informations)
    ]
    score, information = parts
    others = information.sum(axis=0) - information
    known = others > TUNING.adequacy_rare * information.sum(
        axis=0
    )  # otherwise the force acts in one part alone, and the other parts contain no information
    size = np.where(known, (score.sum(axis=0) - score) / np.where(known, others, 1.0), 0.0)
    return np.asarray(np.sum(2 * size * score - size**2 * information, axis=0))


def _effects(difference: Difference, q: Floats, candidates: Sequence[CandidateForce]) -> Floats:
    """Return the change of the simulated position [counts] (n, k) for a unit of each of k forces."""
    effects = np.zeros((difference.rows, len(candidates)))
    fineness = [candidate.force.size for candidate in candidates]
    for size in dict.fromkeys(fineness):
        alike = [k for k, own in enumerate(fineness) if own == size]
        for some in (alike[k : k + _PAIRS] for k in range(0, len(alike), _PAIRS)):
            effects[:, some] = _effects_alike(difference, q, [candidates[k] for k in some])
    return effects


#: Number of forces that are simulated at once, each with both signs.
_PAIRS = TUNING.trials_together // 2


def _effects_alike(difference: Difference, q: Floats, candidates: Sequence[CandidateForce]) -> Floats:
    """Return the change of the simulated position [counts] (n, k) for forces over equal parts of a sample."""
    usual = TUNING.step_of_force * abs(difference.equation.input_gain) * rms(difference.u)
    sizes = np.array([TUNING.adequacy_step * one.plausible or usual / rms(one.force) for one in candidates])
    forces = sizes[:, None] * np.array([candidate.force for candidate in candidates], np.float64)
    forces = np.concatenate([-forces, forces])
    found = difference.motions(np.tile(q, (2 * sizes.size, 1)), forces)[0]
    more, less = np.split(found, 2)
    signals = [difference.observe(row) for row in more - less]
    return np.asarray(np.array(signals).T / (2 * sizes))


def is_contradicted(fit: Fit, best: Fit, spread: Floats) -> bool:
    """Return whether an estimate contradicts the fit of an adequate model.

    The difference must exceed both standard errors and `spread` (p,) together.
    """
    allowed = np.sqrt(fit.theta_std**2 + best.theta_std**2 + spread**2)
    return bool(np.any(np.abs(fit.theta - best.theta) > TUNING.adequacy_contradicted * allowed))


def force_moves(found: Adequacy, estimator: Estimator, columns: Columns) -> Floats:
    """Return the shift (p, k) of an estimate with instruments, at its columns, for a unit of each force.

    If an instrument is zero throughout, the shifts of the best fit take their place.
    """
    if not np.all(np.any(columns.zeta != 0, axis=0)):
        return found.moves[: columns.zeta.shape[1]]
    n = columns.used.size
    forces = np.column_stack(
        [filter_force(candidate.force, estimator, n) for candidate in found.forces] or [np.zeros((n, 0))]
    )
    gain = solve_with_instruments(columns)[1]
    return np.asarray(-gain @ (columns.zeta.T @ forces[columns.used]))


def filter_force(force: Floats, estimator: Estimator, n: int) -> Floats:
    """Return a force (n,) after the filters of an estimator.

    The force is constant over each of n intervals, or over each of their parts. The estimator's columns come one sample
    later.
    """
    return np.asarray(filter_forces(force[None], estimator, force.size // n)[0])


def filter_forces(forces: Floats, estimator: Estimator, parts: int = 1) -> Floats:
    """Return forces (k, parts n) after the filters of an estimator (k, n)."""
    rate = 2 * parts / estimator.dt
    pole = (rate - estimator.cutoff) / (rate + estimator.cutoff)
    gain = estimator.cutoff / (rate + estimator.cutoff)
    late = np.concatenate([np.zeros((forces.shape[0], parts)), forces[:, :-parts]], axis=1)
    for stage in range(estimator.order):
        b = (0.0, 2 * gain) if stage == 0 else (gain, gain)
        late = np.array([first_order(row, pole, *b)[0] for row in late]).reshape(late.shape)
    return np.asarray(late[:, ::parts])
