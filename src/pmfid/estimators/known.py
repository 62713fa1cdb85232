"""Parameters that are known, put together with an estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.deprecation import rename_method
from pmfid.errors import NotIdentifiableError, UsageError, place_of
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import check_arrays, like
from pmfid.estimators.facts import INPUT_GAIN, check_known, forces_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Fit, Track, join_tracks
from pmfid.estimators.runner import Runner
from pmfid.estimators.tuning import TUNING
from pmfid.models.drive import Drive
from pmfid.presentation import Parameters, Presentable, Summary, remarks_of
from pmfid.status import status_names
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._estimate import Estimate


@dataclass(frozen=True)
class Facts:
    """k facts on p parameters and the gain: index (k,) of the parameter, p: of the gain; value, std (k,); forces (p,):
    which parameters go with the gain; free: is the gain to be found?"""

    index: NDArray[np.intp]
    value: Floats
    std: Floats
    forces: NDArray[np.bool_]
    free: bool


@dataclass(frozen=True)
class Combined:
    """theta (n, p + 1), the last one the gain over the estimate's gain; noise (n, p + 1, p + 1): its covariance;
    moves (n, p + 1, p): by how much it moves for an error of the estimate; apart (n, k): by how many standard
    deviations each fact differs from what all others say."""

    theta: Floats
    noise: Floats
    moves: Floats
    apart: Floats


def combine(estimate: Floats, covariance: Floats, further: Floats, facts: Facts) -> Combined:
    """Combine estimates (n, p) with covariances (n, p, p) and the same facts. further (n, p): variances in addition to
    noise, which count in the weights and stay out of the returned covariance. NaN if an estimate does not determine the
    gain.
    """
    total = covariance + further[..., None] * np.eye(estimate.shape[1])
    with np.errstate(all="ignore"):  # what comes of a parameter that is zero, or of nothing known, is NaN
        a, b = estimate, _start(estimate, total, facts)
        for _ in range(TUNING.known_most_steps):
            step = _linear(a, b, total, facts)
            rest = facts.value - step.h + _times(step.by_a, a - estimate)
            change = np.sum(step.gain_b * rest, axis=1)
            a, b, before = estimate + _times(step.gain_a, rest), b + change, b
            if not np.any(np.abs(b - before) > TUNING.known_converged * np.abs(b)):
                break
        return _make_combined(estimate, covariance, a, b, _linear(a, b, total, facts), facts)


@dataclass(frozen=True)
class _Linear:
    """h (n, k) and its derivatives by_a (n, k, p), by_b (n, k) at a place; gain_a (n, p, k), gain_b (n, k): by how much
    a rest of the facts moves a and b; left (n, k): variances of the rests, without what b takes up; total (n, k): with
    it."""

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
    """The gain (n,) that the fact which knows it best gives alone."""
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
    tested = last.left > TUNING.known_untested * last.total
    apart = np.where(tested, rest / np.sqrt(np.where(tested, last.left, 1.0)), 0.0)
    return Combined(np.concatenate([own * a, b[:, None]], axis=1), noise, moves, apart)


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Presentable):
    """An estimate combined with prior information. names, units: of the q parameters, the gain of the input last if it
    was unknown; theta: (q,); theta_cov: (q, q); model_spread: (q,) or None; notes: contradictions."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Floats
    theta_cov: Floats
    model_spread: Floats | None = None
    notes: tuple[str, ...] = ()

    @property
    def theta_std(self) -> Floats:
        """(q,) standard deviations."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.theta_cov), 0.0)))

    def __getitem__(self, name: str) -> float:
        """One parameter. Raises UnknownParameterError, a KeyError, listing the names."""
        return float(self.theta[place_of(name, self.names)])

    @property
    def _parameters(self) -> Parameters:
        return Parameters(self.names, self.units, self.theta, self.theta_std)

    def summary(self) -> Summary:
        return self._parameters.summary("an estimate with prior information", remarks_of((), self.notes))

    def columns(self) -> dict[str, object]:
        """A row for each parameter."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        return {"parameters": self._parameters.content, "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class Known:
    """Prior information on the parameters of an estimator of any method, combined with its estimates.

    Parameters
    ----------
    estimator : Estimator
    given : mapping
        Values by name.
    prior : mapping
        (mean, standard deviation) by name, Gaussian. A standard deviation of 0 is as given.
    find_gain : bool
        The gain of the input is unknown. The estimator's `Drive` has any gain of the right sign, and a known force
        determines the gain of the machine; `input_gain` may have a prior then.

    Raises
    ------
    UsageError
        A name or value that is none, a value that is known twice, or a gain that nothing gives.

    Notes
    -----
    `of` is for a fit or the estimate of a step, `run` for the samples of a recursive method. A prior counts once,
    however long the record is: with a memory it holds at every time. It is weighed by the error bars of the estimate.

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
            raise UsageError("the gain of the input is found of a Drive; give the coefficient of the input as it is")
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
        """(p,): the coefficients that go with the gain of the input; times, speeds and filters do not."""
        forces = forces_of(self.estimator.equation)
        return np.array([name in forces for name in self.estimator.names])

    @property
    def _facts(self) -> dict[str, tuple[float, float]]:
        given = {name: (float(value), 0.0) for name, value in self.given.items()}
        return given | {name: (float(mean), float(std)) for name, (mean, std) in self.prior.items()}

    @cached_property
    def facts(self) -> Facts:
        """The same in the terms of `combine`."""
        gain = self.estimator.equation.input_gain
        unit = {name: gain if name == INPUT_GAIN else 1.0 for name in self._facts}
        rows = [(value / unit[name], std / abs(unit[name])) for name, (value, std) in self._facts.items()]
        value, std = np.array(rows).reshape(-1, 2).T
        index = np.array([self.names.index(name) for name in self._facts], dtype=np.intp)
        return Facts(index, value, std, self._forces, self.find_gain)

    def combine(self, found: Fit | Estimate | Posterior, model_spread: Floats | None = None) -> Posterior:
        """An estimate combined with prior information. model_spread (p,): how far unmodelled effects may move each
        parameter, as an independent error; it weighs as the error bars do, and NaN is none.

        Raises NotIdentifiableError if the error bars of the estimate, or the gain of the input, are not known.
        """
        theta, covariance = np.asarray(found.theta), np.asarray(found.theta_cov)
        further = np.zeros(theta.size) if model_spread is None else np.nan_to_num(model_spread) ** 2
        if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(covariance))):
            raise NotIdentifiableError(
                "the record gives no error bars, and without them nothing can be weighed against what is known: record "
                "longer, or leave given and prior out"
            )
        try:
            combined = combine(theta[None], covariance[None], further[None], self.facts)
        except np.linalg.LinAlgError:
            combined = None
        if combined is None or not (np.all(np.isfinite(combined.theta)) and np.all(np.isfinite(combined.noise))):
            raise NotIdentifiableError(
                f"what is known ({', '.join(self._facts)}) and what the record says do not go together: check the "
                "values, or leave one out"
            )
        values, noise = self._scale_to_machine(combined)
        spread = None if model_spread is None else self._spread(combined, model_spread, further)
        notes = self._contradictions(combined.apart[0], theta, covariance, further)
        return Posterior(self.names, self.units, values[0], noise[0], spread, notes)

    of = rename_method("of", "combine")

    def _spread(self, combined: Combined, model_spread: Floats, further: Floats) -> Floats:
        """(q,) how far the model spread of each parameter moves the combined result; NaN: not known."""
        spread = np.sqrt(combined.moves[0, : len(self.names)] ** 2 @ further) * np.abs(self._gain_scale)
        spread[: model_spread.size][np.isnan(model_spread)] = np.nan
        spread[[self.names.index(name) for name in self._given]] = 0.0
        return np.asarray(spread)

    @property
    def _given(self) -> dict[str, float]:
        return {name: value for name, (value, std) in self._facts.items() if std == 0}

    def _scale_to_machine(self, combined: Combined) -> tuple[Floats, Floats]:
        """theta (n, q) and covariances (n, q, q), with the gain of the machine; given values stay as they are."""
        q, scale = len(self.names), self._gain_scale
        values, noise = combined.theta[:, :q] * scale, combined.noise[:, :q, :q] * np.outer(scale, scale)
        for name, value in self._given.items():
            i = self.names.index(name)
            values[:, i], noise[:, i], noise[:, :, i] = value, 0.0, 0.0
        return values, noise

    @property
    def _gain_scale(self) -> Floats:
        """(q,): the estimator's gain, by which the relative gain of `combine` is multiplied."""
        return np.concatenate(
            [np.ones(len(self.estimator.names)), [self.estimator.equation.input_gain] * self.find_gain]
        )

    def _contradictions(self, apart: Floats, theta: Floats, covariance: Floats, further: Floats) -> tuple[str, ...]:
        named = [
            (name, f"{name} = {value:.6g}" + (f" ± {own:.2g}" if own else ""))
            for (name, (value, own)), away in zip(self._facts.items(), apart, strict=True)
            if abs(away) > TUNING.known_contradicted
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
        """The same with the found gain as the estimator's gain, and the estimate in forces of the machine."""
        gain = self.combine(found)[INPUT_GAIN]
        own = np.where(self._forces, gain / self.estimator.equation.input_gain, 1.0)
        theta, covariance = found.theta * own, found.theta_cov * np.outer(own, own)
        there = replace(self, estimator=with_gain(self.estimator, gain))
        return there, Posterior(self.estimator.names, self.estimator.units, theta, covariance)

    def track(self, track: Track, last: Estimate) -> Track:
        """A piece of a track with prior information. last: the estimate at its end, whose correlations hold for all of
        the piece. Before the first estimate theta is 0 and the error bars are infinite, also for given values."""
        std, (n, p) = track.theta_std, track.theta.shape
        theta, errors = np.zeros((n, len(self.names))), np.full((n, len(self.names)), np.inf)
        own = np.asarray(last.theta_cov)
        known = np.all(np.isfinite(std), axis=1) & bool(np.all(np.isfinite(own)))
        size = np.sqrt(np.outer(np.diagonal(own), np.diagonal(own)))
        alike = np.divide(own, size, out=np.eye(p), where=(size > 0) & np.isfinite(size))
        covariance = alike * std[known, :, None] * std[known, None, :]
        with suppress(np.linalg.LinAlgError):  # of facts that contradict each other: nothing is known then
            combined = combine(track.theta[known], covariance, np.zeros((covariance.shape[0], p)), self.facts)
            theta[known], noise = self._scale_to_machine(combined)
            errors[known] = np.sqrt(np.maximum(np.einsum("nii->ni", noise), 0.0))
        unknown = ~np.all(np.isfinite(theta) & np.isfinite(errors), axis=1)
        errors[unknown], theta[unknown] = np.inf, 0.0
        return track.with_bars(self.names, self.units, theta, errors)

    def run(self, runner: RecursiveEstimator | Runner[RecursiveEstimator], u: ArrayLike, counts: ArrayLike) -> Track:
        """Many samples at once as `Runner.run` of an estimation that is under way, u, counts: (n,)."""
        u, counts = check_arrays(u, counts)
        parts = []
        for start in range(0, max(1, u.size), TUNING.known_piece):
            part = runner.run(u[start : start + TUNING.known_piece], counts[start : start + TUNING.known_piece])
            parts.append(self.track(part, runner.estimate))
        return join_tracks(parts)


def choose_naming(estimator: Estimator, known: Known | None) -> Estimator | Known:
    """The object with the names and units of the result: the prior information if there is any, or the estimator."""
    return estimator if known is None else known


@dataclass(frozen=True, eq=False, repr=False)
class Seen(Presentable):
    """The estimate of a step combined with prior information at the first use. Before the first estimate theta is 0 and
    the error bars are infinite."""

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
        """A row for each parameter."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        return {"parameters": self._parameters.content, "status": status_names(self.status)}


def with_gain(estimator: Estimator, gain: float) -> Estimator:
    """The same estimator with another gain of the input. Raises UsageError for one that is none."""
    if not isinstance(estimator.model, Drive):
        raise UsageError("the gain of the input is found of a Drive")
    return like(type(estimator), estimator, model=replace(estimator.model, input_gain=gain))
