"""Combination of an estimate with known parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import INPUT_GAIN, check_known, forces_of
from pmfid.estimators.iv import INSTRUMENTS_MAX_ITERATIONS
from pmfid.estimators.results import Fit, Track
from pmfid.models.drive import Drive
from pmfid.presentation import Parameters, Presentable, PresentableParameters, Summary, remarks_of
from pmfid.status import status_names
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._estimate import Estimate

KNOWN_CONVERGED = 1e-13
#: No other information tests a fact whose remaining variance is below this part.
KNOWN_UNTESTED = 1e-9
#: A fact and a record, or a method and the fit, contradict each other from this number of standard deviations of
#: their difference. A smaller error is noise.
CONTRADICTED = 3.0


@dataclass(frozen=True)
class Facts:
    """k facts on p parameters and the input gain.

    `index` (k,) is the index of each fact's parameter; p stands for the gain. `value` and `std` (k,) are the facts'
    values and standard deviations. `forces` (p,) marks the parameters that scale with the gain. `free` is True for an
    unknown gain.
    """

    index: NDArray[np.intp]
    value: Floats
    std: Floats
    forces: NDArray[np.bool_]
    free: bool


@dataclass(frozen=True)
class Combined:
    """n estimates after their combination with facts.

    `theta` (n, p + 1) ends with the ratio of the gain to the estimate's gain, and `noise` (n, p + 1, p + 1) is its
    covariance. `moves` (n, p + 1, p) is the derivative of `theta` by the original estimate. `apart` (n, k) is the
    distance between each fact and all other information, in standard deviations.
    """

    theta: Floats
    noise: Floats
    moves: Floats
    apart: Floats


def combine(estimate: Floats, covariance: Floats, further: Floats, facts: Facts) -> Combined:
    """Combine the estimates (n, p) and their covariances (n, p, p) with the same facts.

    The variances `further` (n, p) count in the weights in addition to noise. The returned covariance excludes
    `further`. The result is NaN if an estimate does not determine the gain.
    """
    total = covariance + further[..., None] * np.eye(estimate.shape[1])
    with np.errstate(all="ignore"):  # a parameter of zero or missing knowledge gives NaN
        a, b = estimate, _start(estimate, total, facts)
        for _ in range(INSTRUMENTS_MAX_ITERATIONS):
            step = _linear(a, b, total, facts)
            rest = facts.value - step.h + _times(step.by_a, a - estimate)
            change = np.sum(step.gain_b * rest, axis=1)
            a, b, before = estimate + _times(step.gain_a, rest), b + change, b
            if not np.any(np.abs(b - before) > KNOWN_CONVERGED * np.abs(b)):
                break
        return _make_combined(estimate, covariance, a, b, _linear(a, b, total, facts), facts)


@dataclass(frozen=True)
class _Linear:
    """The facts, linearised at one place (a, b).

    `h` (n, k) are the predicted facts, with derivatives `by_a` (n, k, p) and `by_b` (n, k). The gains `gain_a` (n, p,
    k) and `gain_b` (n, k) convert errors of the facts to changes of a and b. `total` (n, k) are the variances of these
    errors. `left` (n, k) are the variances that remain after the adjustment of b.
    """

    h: Floats
    by_a: Floats
    gain_a: Floats
    gain_b: Floats
    left: Floats
    total: Floats


def _linear(a: Floats, b: Floats, total: Floats, facts: Facts) -> _Linear:
    n, p = a.shape
    k = facts.index.size
    of_gain, index = facts.index == p, np.minimum(facts.index, p - 1)
    force = facts.forces[index] & ~of_gain
    h = np.where(of_gain, b[:, None], np.where(force, b[:, None] * a[:, index], a[:, index]))
    by_a = np.zeros((n, k, p))
    by_a[:, np.arange(k), index] = np.where(of_gain, 0.0, np.where(force, b[:, None], 1.0))
    by_b = np.where(of_gain, 1.0, np.where(force, a[:, index], 0.0)) * facts.free
    spread = np.einsum("nki,nij,nlj->nkl", by_a, total, by_a) + np.diag(facts.std**2)
    size = np.sqrt(np.einsum("nkk->nk", spread))
    inverse = np.linalg.inv(spread / (size[:, :, None] * size[:, None, :])) / (size[:, :, None] * size[:, None, :])
    weighted = np.einsum("nkl,nl->nk", inverse, by_b)
    known = np.sum(by_b * weighted, axis=1)[:, None]
    gain_b = weighted / known if facts.free else np.zeros((n, k))
    reach = np.einsum("nij,nkj,nkl->nil", total, by_a, inverse)
    gain_a = reach - np.einsum("nil,nl,nk->nik", reach, by_b, gain_b)
    taken = by_b**2 / known if facts.free else np.zeros((n, k))
    return _Linear(h, by_a, gain_a, gain_b, size**2 - taken, size**2)


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray(np.einsum("...ij,...j->...i", matrix, vector))


def _start(estimate: Floats, total: Floats, facts: Facts) -> Floats:
    """Return the gain (n,) that follows from the most accurate single fact."""
    n, p = estimate.shape
    if not facts.free:
        return np.ones(n)
    of_gain, index = facts.index == p, np.minimum(facts.index, p - 1)
    own, variance = estimate[:, index], np.einsum("nii->ni", total)[:, index]
    gains = np.where(of_gain, facts.value, facts.value / own)
    unsure = np.where(of_gain, 0.0, variance / own**2) + (facts.std / facts.value) ** 2
    usable = of_gain | (facts.forces[index] & (facts.value != 0))
    best = np.argmin(np.where(usable & np.isfinite(unsure), unsure, np.inf), axis=1)
    return np.asarray(np.take_along_axis(gains, best[:, None], axis=1)[:, 0])


def _make_combined(estimate: Floats, covariance: Floats, a: Floats, b: Floats, last: _Linear, facts: Facts) -> Combined:
    p = a.shape[1]
    moves_a = np.eye(p) - last.gain_a @ last.by_a
    moves_b = -np.einsum("nk,nkp->np", last.gain_b, last.by_a)
    own = np.where(facts.forces, b[:, None], 1.0)
    with_b = np.where(facts.forces, a, 0.0)
    moves = np.concatenate(
        [own[:, :, None] * moves_a + with_b[:, :, None] * moves_b[:, None], moves_b[:, None]], axis=1
    )
    pull = np.concatenate(
        [own[:, :, None] * last.gain_a + with_b[:, :, None] * last.gain_b[:, None], last.gain_b[:, None]], axis=1
    )
    noise = np.einsum("nij,njk,nlk->nil", moves, covariance, moves) + np.einsum(
        "nik,k,nlk->nil", pull, facts.std**2, pull
    )
    rest = facts.value - last.h + _times(last.by_a, a - estimate)
    tested = last.left > KNOWN_UNTESTED * last.total
    apart = np.where(tested, rest / np.sqrt(np.where(tested, last.left, 1.0)), 0.0)
    return Combined(np.concatenate([own * a, b[:, None]], axis=1), noise, moves, apart)


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(PresentableParameters):
    """An estimate combined with prior information.

    `names` and `units` describe the q parameters; an unknown input gain comes last. `theta` (q,) has the covariance
    `theta_cov` (q, q). `model_spread` is an array (q,) or None. `notes` describe contradictions.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Floats
    theta_cov: Floats
    model_spread: Floats | None = None
    notes: tuple[str, ...] = ()

    @property
    def theta_std(self) -> Floats:
        """Standard deviations (q,)."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.theta_cov), 0.0)))

    def summary(self) -> Summary:
        return self._parameters.summary("an estimate with prior information", remarks_of((), self.notes))

    def to_dict(self) -> dict[str, object]:
        return {"parameters": self._parameters.content, "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class Known:
    """Prior information on the parameters of any estimator, combined with its estimates.

    Parameters
    ----------
    estimator : Estimator
    given : mapping
        Values by name.
    prior : mapping
        (mean, standard deviation) by name, Gaussian. A prior with standard deviation 0 is a given value.
    find_gain : bool
        Whether the input gain is unknown. The estimator's `Drive` then has any gain of the right sign, and a known
        force determines the true gain. If `find_gain` is True, `input_gain` may have a prior.

    Raises
    ------
    UsageError
        A name or value is invalid, a value is known twice, or nothing determines the gain.

    Notes
    -----
    `combine` takes a fit or the estimate of one step, and `track` takes a part of the track of a recursive method. A
    prior counts once, for records of any length. For an estimator with a memory, the prior holds at every time. The
    weight of a prior follows from the estimate's error bars.

    Examples
    --------
    >>> from pmfid import RIV, Drive, Encoder, Known
    >>> riv = RIV(Drive(1.0), Encoder(1e-5), 0.001, 50.0, forgetting=0.9995)
    >>> Known(riv, given={"mass": 1.25}, find_gain=True).names
    ('mass', 'viscous_friction', 'coulomb_friction', 'input_gain')
    """

    estimator: Estimator
    given: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, Sequence[float]] = field(default_factory=dict)
    find_gain: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "given", dict(self.given))
        pairs = {name: pair if isinstance(pair, Real) else tuple(pair) for name, pair in self.prior.items()}
        object.__setattr__(self, "prior", pairs)
        if self.find_gain and not isinstance(self.estimator.model, Drive):
            raise UsageError(
                "the gain of the input can be estimated only for a Drive; for this model, give the "
                "coefficient of the input"
            )
        check_known(self.estimator.equation, self.given, self.prior, self.names, self.find_gain)

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.estimator.names, *([INPUT_GAIN] if self.find_gain else []))

    @property
    def _gain_unit(self) -> str:
        return f"{self.estimator.equation.motion.force} per u"

    @property
    def units(self) -> tuple[str, ...]:
        return (*self.estimator.units, *([self._gain_unit] if self.find_gain else []))

    @property
    def _forces(self) -> NDArray[np.bool_]:
        """Mask (p,) of the coefficients that scale with the input gain. Times, speeds and filters do not scale."""
        forces = forces_of(self.estimator.equation)
        return np.array([name in forces for name in self.estimator.names])

    @property
    def _facts(self) -> dict[str, tuple[float, float]]:
        given = {name: (float(value), 0.0) for name, value in self.given.items()}
        return given | {name: (float(mean), float(std)) for name, (mean, std) in self.prior.items()}

    @cached_property
    def facts(self) -> Facts:
        """The prior information in the form that `combine` takes."""
        gain = self.estimator.equation.input_gain
        unit = {name: gain if name == INPUT_GAIN else 1.0 for name in self._facts}
        rows = [(value / unit[name], std / abs(unit[name])) for name, (value, std) in self._facts.items()]
        value, std = np.array(rows).reshape(-1, 2).T
        index = np.array([self.names.index(name) for name in self._facts], dtype=np.intp)
        return Facts(index, value, std, self._forces, self.find_gain)

    def combine(self, found: Fit | Estimate | Posterior, model_spread: Floats | None = None) -> Posterior:
        """Return an estimate combined with the prior information.

        `model_spread` (p,) limits the shift of each parameter by unmodelled effects. `model_spread` counts as an
        independent error with the weight of an error bar, and NaN counts as zero. Raises NotIdentifiableError if the
        estimate's error bars or the input gain are unknown.
        """
        theta, covariance = np.asarray(found.theta), np.asarray(found.theta_cov)
        further = np.zeros(theta.size) if model_spread is None else np.nan_to_num(model_spread) ** 2
        if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(covariance))):
            raise NotIdentifiableError(
                "the record gives no error bars, so it cannot be combined with given values and priors: "
                "record longer, or remove given and prior"
            )
        try:
            combined = combine(theta[None], covariance[None], further[None], self.facts)
        except np.linalg.LinAlgError:
            combined = None
        if combined is None or not (np.all(np.isfinite(combined.theta)) and np.all(np.isfinite(combined.noise))):
            raise NotIdentifiableError(
                f"the given values and priors ({', '.join(self._facts)}) contradict the record: check the "
                "values, or remove one"
            )
        values, noise = self._scale_to_machine(combined)
        spread = None if model_spread is None else self._spread(combined, model_spread, further)
        notes = self._contradictions(combined.apart[0], theta, covariance, further)
        return Posterior(self.names, self.units, values[0], noise[0], spread, notes)

    def _spread(self, combined: Combined, model_spread: Floats, further: Floats) -> Floats:
        """Return the change (q,) of the combined result by each model spread. NaN stands for unknown."""
        spread = np.sqrt(combined.moves[0, : len(self.names)] ** 2 @ further) * np.abs(self._gain_scale)
        spread[: model_spread.size][np.isnan(model_spread)] = np.nan
        spread[[self.names.index(name) for name in self._given]] = 0.0
        return np.asarray(spread)

    @property
    def _given(self) -> dict[str, float]:
        return {name: value for name, (value, std) in self._facts.items() if std == 0}

    def _scale_to_machine(self, combined: Combined) -> tuple[Floats, Floats]:
        """Return theta (n, q) and covariances (n, q, q) with the machine's gain. Given values do not change."""
        q, scale = len(self.names), self._gain_scale
        values, noise = combined.theta[:, :q] * scale, combined.noise[:, :q, :q] * np.outer(scale, scale)
        for name, value in self._given.items():
            i = self.names.index(name)
            values[:, i], noise[:, i], noise[:, :, i] = value, 0.0, 0.0
        return values, noise

    @property
    def _gain_scale(self) -> Floats:
        """Factors (q,) that convert the relative gain of `combine` to the estimator's unit."""
        return np.concatenate(
            [np.ones(len(self.estimator.names)), [self.estimator.equation.input_gain] * self.find_gain]
        )

    def _contradictions(self, apart: Floats, theta: Floats, covariance: Floats, further: Floats) -> tuple[str, ...]:
        named = [
            (name, f"{name} = {value:.6g}" + (f" ± {own:.2g}" if own else ""))
            for (name, (value, own)), away in zip(self._facts.items(), apart, strict=True)
            if abs(away) > CONTRADICTED
        ]
        if not named:
            return ()
        std, rest = np.sqrt(np.diagonal(covariance) + further), "what else is known, with the record,"
        if len(named) == 1 and not self.find_gain:
            i = self.names.index(named[0][0])
            rest = f"the record, which alone gives {theta[i]:.4g} ± {std[i]:.2g},"
        elif len(named) > 1:
            rest = "each other or the record"
        return (
            f"{' and '.join(text for _, text in named)} contradict{'s' * (len(named) == 1)} {rest} by "
            f"{float(np.max(np.abs(apart))):.2g} standard deviations",
        )

    def rescale(self, found: Fit | Estimate | Posterior) -> tuple[Known, Posterior]:
        """Return a copy whose estimator has the found gain, and the estimate in the machine's forces."""
        gain = self.combine(found)[INPUT_GAIN]
        own = np.where(self._forces, gain / self.estimator.equation.input_gain, 1.0)
        theta, covariance = found.theta * own, found.theta_cov * np.outer(own, own)
        there = replace(self, estimator=with_gain(self.estimator, gain))
        return there, Posterior(self.estimator.names, self.estimator.units, theta, covariance)

    def track(self, track: Track, last: Estimate) -> Track:
        """Return a part of a track with prior information.

        `last` is the estimate at the end of this part. The correlations of `last` hold for the whole part. Before the
        first estimate, theta is 0 and the error bars are infinite, even for given values.
        """
        std, (n, p) = track.theta_std, track.theta.shape
        theta, errors = np.zeros((n, len(self.names))), np.full((n, len(self.names)), np.inf)
        own = np.asarray(last.theta_cov)
        known = np.all(np.isfinite(std), axis=1) & bool(np.all(np.isfinite(own)))
        size = np.sqrt(np.outer(np.diagonal(own), np.diagonal(own)))
        alike = np.divide(own, size, out=np.eye(p), where=(size > 0) & np.isfinite(size))
        covariance = alike * std[known, :, None] * std[known, None, :]
        with suppress(np.linalg.LinAlgError):  # facts that contradict each other leave nothing known
            combined = combine(track.theta[known], covariance, np.zeros((covariance.shape[0], p)), self.facts)
            theta[known], noise = self._scale_to_machine(combined)
            errors[known] = np.sqrt(np.maximum(np.einsum("nii->ni", noise), 0.0))
        unknown = ~np.all(np.isfinite(theta) & np.isfinite(errors), axis=1)
        errors[unknown], theta[unknown] = np.inf, 0.0
        return track.with_bars(self.names, self.units, theta, errors)


def choose_naming(estimator: Estimator, known: Known | None) -> Estimator | Known:
    """Return the object that has the names and units of the result: the prior information, or else the estimator."""
    return estimator if known is None else known


@dataclass(frozen=True, eq=False, repr=False)
class Seen(Presentable):
    """The estimate of one step, combined with prior information at the first use. Before the first estimate, theta is 0
    and the error bars are infinite."""

    known: Known
    estimate: Estimate

    @cached_property
    def _found(self) -> Posterior | None:
        try:
            return self.known.combine(self.estimate)
        except NotIdentifiableError:
            return None

    @property
    def theta(self) -> Floats:
        return np.zeros(len(self.known.names)) if self._found is None else self._found.theta

    @property
    def theta_std(self) -> Floats:
        return np.full(len(self.known.names), np.inf) if self._found is None else self._found.theta_std

    @property
    def innovation(self) -> float:
        return self.estimate.innovation

    @property
    def status(self) -> int:
        return self.estimate.status

    @property
    def _parameters(self) -> Parameters:
        return Parameters(self.known.names, self.known.units, self.theta, self.theta_std)

    def summary(self) -> Summary:
        title = "the estimate of a sample, with prior information"
        return self._parameters.summary(title, remarks_of(status_names(self.status)))

    def columns(self) -> dict[str, object]:
        """Table with a row for each parameter."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        return {"parameters": self._parameters.content, "status": status_names(self.status)}


def with_gain(estimator: Estimator, gain: float) -> Estimator:
    """Return a copy of the estimator with another input gain. Raises UsageError for a model other than `Drive`."""
    if not isinstance(estimator.model, Drive):
        raise UsageError("the gain of the input can be estimated only for a Drive")
    return like(type(estimator), estimator, model=replace(estimator.model, input_gain=gain))
