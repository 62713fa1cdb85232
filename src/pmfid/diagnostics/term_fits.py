"""Fits of several models to one record, each started from the fit of another model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.free_run import drive_run
from pmfid.diagnostics.term_trials import Trial, candidates, carry_parameters, drop_neighbours, free_pitch
from pmfid.diagnostics.tuning import TUNING
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import Change
from pmfid.estimators.configuration import change_arguments, like
from pmfid.estimators.instruments import Instruments
from pmfid.estimators.likelihood import Best, climb, log_likelihood
from pmfid.estimators.motion import Difference, first_speed, least, rms
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.estimators.search import find_least_from_start, fit_at_speeds, predicted_elsewhere, read_start
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.models.drive import Drive, EquationModel
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, LATE, MOST_LATE, Equation
from pmfid.types import Floats


@dataclass(frozen=True)
class Bench:
    """The record and the method for all fits of a search.

    All models are fitted to u (n,) and counts (n,). The model of `method` is the first model. `other` holds u and
    counts of another record of the same machine, for validation. If `other` is None, the models predict parts of the
    first record from the remaining parts.
    """

    method: IntervalML
    u: Floats
    counts: NDArray[np.int64]
    other: tuple[Floats, NDArray[np.int64]] | None = None

    def first(self, model: Drive) -> Trial:
        """Return the fit of a model that starts from instrumental variables.

        Raises NotIdentifiableError if the record does not identify the model.
        """
        if model.equation.searched:
            return self.further(self.first(change_arguments(model, {"stribeck": None})), {"stribeck": model.stribeck})
        method = like(IntervalML, self.method, model=model)
        difference, q, status = method.fit_least_squares(self.u, self.counts)
        return make_trial(method, model, difference, q, status)

    def further(self, trial: Trial, change: Change) -> Trial:
        """Return the fit of the model with some changed fields, started at the parameters of the previous fit."""
        return self.fit_model(change_arguments(trial.model, change), trial)

    def pitches(self, trial: Trial) -> list[tuple[float, float]]:
        """Return the doubled gains of the log-likelihood and the pitches [unit of y] of cogging forces, best first.

        The gains are approximate. The pitches come from scans. The list is empty if the model explains every count.
        """
        if trial.best.clean:
            return []
        travel, found = float(np.ptp(trial.difference.y)), list[tuple[float, float]]()
        numbers, tried = candidates(self.method, self.u, self.counts, trial.best), list[float]()
        while numbers:
            for number in numbers:
                with suppress(NotIdentifiableError, UsageError):
                    found.append(self._fit_pitch(change_arguments(trial.model, {"cogging": travel / number}), trial))
            tried += [*numbers, *(travel / pitch for _, pitch in found)]
            # If all motions are similar, the counts hardly distinguish n pitches in the travel from n + 1 pitches.
            own = travel / max(found)[1] if found else TUNING.term_trials_fewest
            numbers = [
                one
                for one in (own - 1, own + 1)
                if one >= TUNING.term_trials_fewest and min(abs(one - k) for k in tried) > TUNING.term_trials_apart
            ]
        return [
            (2 * (likely - trial.log_likelihood), pitch)
            for likely, pitch in _different(sorted(found, reverse=True), travel)
            if likely > trial.log_likelihood
        ][: TUNING.most_pitches]

    def scan_pitches(self, trial: Trial) -> list[float]:
        """Return the pitches [unit of y] of cogging forces at the peaks of the scans, without a fit."""
        travel = float(np.ptp(trial.difference.y))
        return [travel / number for number in candidates(self.method, self.u, self.counts, trial.best)]

    def _fit_pitch(self, model: Drive, trial: Trial) -> tuple[float, float]:
        """Return the log-likelihood of a least-squares fit that includes the pitch, and the pitch [unit of y].

        If two motions are alike after the high-pass, the edges of the counts distinguish them.
        """
        method = like(IntervalML, self.method, model=model)
        theta = carry_parameters(trial.model.equation, trial.theta, model.equation)
        difference, q = _high_pass(method, self._estimate_by_positions(model, theta), trial.difference)
        filtered = free_pitch(replace(difference, parts=1), model)
        q = least(
            filtered,
            np.r_[read_start(difference, q, method.cutoff), filtered.number / TUNING.term_trials_hundred],
            [TUNING.term_fits_coarsely],
        )
        best, direct = Best(filtered, q, q, None), replace(filtered, pole=0.0)
        if rms(filtered(q)) <= ESTIMATOR_TUNING.output_error_hopeless * direct.explained:
            closer = least(direct, q, [TUNING.term_fits_roughly])
            if rms(direct(closer)) <= direct.explained:
                best = Best(direct, closer, closer, TUNING.term_fits_loose)
        return log_likelihood(best, method.cutoff), float(filtered.model_at(best.q).cogging or math.nan)

    def tune_pitch(self, trial: Trial) -> Trial:
        """Return the trial with the likeliest pitch of its cogging force near the present pitch."""
        free = free_pitch(trial.difference, trial.model)
        q = np.r_[trial.best.q, free.number / TUNING.term_trials_hundred]
        if trial.best.noise is None:
            q, noise = least(free, q, [TUNING.term_fits_roughly]), None
        else:
            _, q, noise = climb(free, q, None, TUNING.term_fits_settled)
        model = free.model_at(q)
        best = replace(trial.best, difference=free.fix_pitch(q), q=q[:-1], noise=noise)
        method = like(IntervalML, trial.method, model=model)
        found = Trial(model, method, best, log_likelihood(best, method.cutoff))
        return max(trial, found, key=lambda one: one.log_likelihood)

    def _estimate_by_positions(self, model: Drive, theta: Floats) -> Floats:
        """Return parameters (p,) by instrumental variables, which take the position from the counts.

        Without a periodic force, the simulated position may be wrong by a whole period. `theta` (p,) gives the
        parameters that instrumental variables do not estimate.
        """
        own, late = model.equation, dict.fromkeys((DEAD_TIME, LAG), 0.0) | _late_of(model.equation, theta)
        given = {key: late[key] for key in (DEAD_TIME, LAG) if getattr(model, key) == ESTIMATE}
        known = change_arguments(model, given | ({"stribeck": None} if model.stribeck == ESTIMATE else {}))
        found = like(Instruments, self.method, model=known).settle_iteration(self.u, self.counts)[1]
        start = np.r_[carry_parameters(known.equation, found, own)[: len(own.names)], theta[len(own.names) :]]
        return _late_by(own, start, late[DEAD_TIME], late[LAG])

    def fit_model(self, model: Drive, trial: Trial) -> Trial:
        """Fit a model from the parameters of another trial.

        Among the fits from several start values, the function returns the likeliest fit, or the first fit that explains
        every count. Raises NotIdentifiableError if no start value converges.
        """
        found, refused = list[Trial](), NotIdentifiableError("the model settles nowhere")
        for theta, begun in self._starts(model, trial):
            try:
                found.append(self._from(model, theta, begun))
            except NotIdentifiableError as error:
                refused = error
                continue
            if found[-1].best.clean:
                break
        if not found:
            raise refused
        return max(found, key=lambda one: one.log_likelihood)

    def _starts(self, model: Drive, trial: Trial) -> Iterator[tuple[Floats, Trial]]:
        """Yield start values (p,), each with a trial whose motion starts alike.

        The start values are the parameters of another model. If the other model has no Stribeck speed, the function
        tries several speeds.
        """
        equation, before = model.equation, trial.model.equation
        theta = carry_parameters(before, trial.theta, equation)
        if late := _lates(model, trial):
            for dead, lag in late:
                yield _late_by(equation, theta, dead, lag), trial
            return
        if model.stribeck != ESTIMATE or trial.model.stribeck == ESTIMATE:
            yield theta, trial
        if model.stribeck == ESTIMATE:
            found = fit_at_speeds(
                trial.usual_speed, self._make_speed_fit(model, theta, trial), lambda one: -one.log_likelihood
            )
            yield from ((np.r_[one.theta, speed], one) for speed, one in found)

    def _make_speed_fit(self, model: Drive, theta: Floats, trial: Trial) -> Callable[[float], Trial]:
        return lambda speed: self._from(change_arguments(model, {"stribeck": speed}), theta[:-1], trial, hasty=True)

    def _from(self, model: Drive, theta: Floats, trial: Trial, hasty: bool = False) -> Trial:
        """Fit a model from theta (p,) and from the start of another trial's motion.

        The fit starts with least squares. If least squares diverge, the fit maximises the likelihood. If `hasty`, any
        least-squares fit is enough.
        """
        method, found = like(IntervalML, self.method, model=model), list[Trial]()
        refused = NotIdentifiableError("the model settles nowhere")
        try:
            found += self._from_squares(model, theta, trial, hasty)
        except NotIdentifiableError as error:
            refused = error
        if trial.best.noise is not None and not (found and (hasty or found[-1].best.clean)):
            difference = _quick(method.make_difference(theta, trial.difference.u, trial.difference.y))
            p = trial.difference.parameters
            start = (trial.best.q * trial.difference.scale)[p : p + 2]
            q = np.maximum(np.r_[theta, start] / difference.scale, difference.lower)
            found.append(_climb_to_top(method, model, difference, q, trial.best.status, hasty))
        found = [one for one in found if _acts_in_time(one)]
        if not found:
            raise refused
        return max(found, key=lambda one: one.log_likelihood)

    def _from_squares(self, model: Drive, theta: Floats, trial: Trial, hasty: bool) -> list[Trial]:
        """Return the fits by least squares. The fit of a force along the travel also starts from instrumental
        variables.
        """
        method, starts = like(IntervalML, self.method, model=model), [theta]
        if any(not term.shape.of_speed for term in model.equation.shaped if term.shape):
            with suppress(NotIdentifiableError):
                starts.insert(0, self._estimate_by_positions(model, theta))
        found = list[Trial]()
        for start in starts:
            difference, q = _follow_record(method, start, trial.difference)
            found.append(make_trial(method, model, difference, q, trial.best.status, hasty))
            if found[-1].best.clean:
                break
        return found

    def settle_fit(self, trial: Trial) -> Trial:
        """Return the trial, fitted to convergence if its motion is within the counts.

        The simulation of a fit to convergence is as fine as the counts require.
        """
        best = trial.best
        if best.noise is None:
            return trial
        difference = best.difference.fine_at(trial.theta)
        _, q, noise = climb(difference, best.q, None)
        found = replace(best, difference=difference, q=q, noise=noise)
        return replace(trial, best=found, log_likelihood=log_likelihood(found, trial.method.cutoff))

    def elsewhere(self, trial: Trial) -> float:
        """Return the error of free runs over data outside the fit [unit of y].

        The data are another record, or thirds of the same record that are predicted from the other thirds. The error is
        infinite if no run is possible.
        """
        if self.other is None:
            return self._predict_parts(trial)
        equation = trial.model.equation
        linear = EquationModel(equation.known_at(trial.theta[len(equation.names) :]))
        method, theta = like(OE, trial.method, model=linear), trial.theta[: len(equation.names)]
        with suppress(UsageError):
            return drive_run(method, theta, *self.other, "the other record").rmse
        return math.inf

    def _predict_parts(self, trial: Trial) -> float:
        equation, n = trial.model.equation, self.u.size
        known = equation.known_at(trial.theta[len(equation.names) :])
        method = like(IntervalML, trial.method, model=EquationModel(known))
        theta = trial.theta[: len(equation.names)]
        difference = replace(method.make_difference(theta, trial.difference.u, trial.difference.y), parts=1)
        scaled = np.maximum(theta / difference.scale[:-2], difference.lower[:-2])
        length = max(
            shortest_part(method),
            n * (ESTIMATOR_TUNING.search_folds - 1) // ESTIMATOR_TUNING.search_folds // TUNING.term_fits_windows,
        )
        return predicted_elsewhere(difference, scaled, method.cutoff, length)


def _lates(model: Drive, trial: Trial) -> list[tuple[float, float]]:
    """Return start values for dead time and lag [s].

    The list is empty if the model and the previous trial estimate the same delays.
    """
    own, before = ([one.dead_time == ESTIMATE, one.lag == ESTIMATE] for one in (model, trial.model))
    if own == before or not any(own) or (own == [True, False] and not any(before)):
        return []
    total, dt = sum(_late_of(trial.model.equation, trial.theta).values()), trial.method.dt
    times = [total] if any(before) and total > 0 else [part * dt for part in TUNING.term_fits_lags]
    shares = [(1.0, 0.1), (0.5, 0.5), (0.1, 1.0)] if all(own) else [(float(own[0]), float(own[1]))]
    return [(dead * time, lag * time) for time in times for dead, lag in shares]


def _acts_in_time(trial: Trial) -> bool:
    """Return whether the input delay is within the limit of a drive."""
    return max(_late_of(trial.model.equation, trial.theta).values(), default=0.0) <= MOST_LATE * trial.method.dt


def _late_of(equation: Equation, theta: Floats) -> dict[str, float]:
    """Return the dead time and the lag [s] in theta (p,) by name, as far as they are parameters."""
    values = dict(zip((*equation.names, *dict(equation.further)), theta.tolist(), strict=True))
    return {key: values[key] for key in (DEAD_TIME, LAG) if key in values}


def _late_by(equation: Equation, theta: Floats, dead: float, lag: float) -> Floats:
    """Return theta (p,) with the given dead time and lag [s], as far as the equation has them."""
    found, linear = theta.copy(), len(equation.names)
    index = equation.roles[LATE]
    if index is not None:
        found[index] = dead
    if equation.lag == ESTIMATE:
        found[linear] = lag
    return found


def _different(found: Sequence[tuple[float, float]], travel: float) -> list[tuple[float, float]]:
    """Return the pairs of gain and pitch without pitches close to an earlier pitch. `travel` has the unit of y."""
    kept = drop_neighbours([travel / pitch for _, pitch in found])
    return [one for one in found if travel / one[1] in kept]


def shortest_part(method: IntervalML) -> int:
    """Return the least number of samples in a predictable part of a record.

    A shorter part contains little more than its start.
    """
    return max(
        ESTIMATOR_TUNING.search_fewest,
        math.ceil(ESTIMATOR_TUNING.search_shortest / (method.cutoff * method.dt) - TUNING.term_fits_rounding),
    )


def choose_cutoff(samples: int, dt: float) -> float | None:
    """Return the lowest cutoff [rad/s] that allows the prediction of a part of a record with the sample period dt [s].

    The result is None if `samples` is too small for a prediction.
    """
    return ESTIMATOR_TUNING.search_shortest / (samples * dt) if samples >= ESTIMATOR_TUNING.search_fewest else None


def make_trial(
    method: IntervalML, model: Drive, difference: Difference, q: Floats, status: int, hasty: bool = False
) -> Trial:
    """Return the trial at the maximum of the likelihood, started from the least-squares unknowns q (q,).

    If the motion is not within the counts, the trial is the least-squares fit itself.
    """
    if difference.pole > 0 or rms(difference(q)) > difference.explained:
        best = Best(difference, q, q, None, status)
        return Trial(model, method, best, log_likelihood(best, method.cutoff))
    return _climb_to_top(method, model, difference, q, status, hasty)


def _follow_record(method: IntervalML, theta: Floats, record: Difference) -> tuple[Difference, Floats]:
    """Return the difference of a record and its rough least-squares unknowns, started from theta (p,).

    If the simulation drifts away, the difference contains a high-pass. A rough fit is enough, because the search
    discards all models but one.
    """
    filtered, q = _high_pass(method, theta, record)
    placed = any(not term.shape.of_speed for term in filtered.equation.shaped if term.shape)
    q = (
        find_least_from_start(filtered, q, method.cutoff, [TUNING.term_fits_roughly])
        if placed
        else least(filtered, q, [TUNING.term_fits_roughly])
    )
    direct = replace(filtered, pole=0.0)
    if rms(filtered(q)) > ESTIMATOR_TUNING.output_error_hopeless * direct.explained:
        return filtered, q
    closer = least(direct, q, [TUNING.term_fits_roughly])
    return (direct, closer) if rms(direct(closer)) <= direct.explained else (filtered, q)


def _quick(difference: Difference) -> Difference:
    """Return the difference with no more parts of a sample than the comparison of models needs."""
    return replace(difference, parts=min(difference.parts, TUNING.most_parts))


def _high_pass(method: IntervalML, theta: Floats, record: Difference) -> tuple[Difference, Floats]:
    """Return the difference of a record after the high-pass, and the unknowns q (q,) for theta (p,)."""
    filtered = replace(_quick(method.make_difference(theta, record.u, record.y)), pole=method.cutoff)
    begin = np.r_[theta, record.y[0], first_speed(record.y, record.dt, method.cutoff, record.resolution)]
    return filtered, np.maximum(begin / filtered.scale, filtered.lower)


@np.errstate(over="ignore", invalid="ignore")  # far from the counts, their probability exceeds the range of numbers
def _climb_to_top(
    method: IntervalML, model: Drive, difference: Difference, q: Floats, status: int, hasty: bool = False
) -> Trial:
    """Return a trial at a maximum of the likelihood near the unknowns q (q,).

    If the maximum may be local, a shrinking noise leads to the global maximum. If `hasty`, the search stops at the
    first maximum.
    """
    found = climb(difference, q, None, TUNING.term_fits_settled)
    if (
        not hasty
        and ESTIMATOR_TUNING.given_away * ESTIMATOR_TUNING.noise_floor < found[2] < TUNING.term_fits_suspicious
    ):
        place = q
        for noise in ESTIMATOR_TUNING.likelihood_shrinking:
            place = climb(difference, place, noise, TUNING.term_fits_settled)[1]
        found = min(found, climb(difference, place, None, TUNING.term_fits_settled), key=lambda one: one[0])
    best = Best(difference, q, found[1], found[2], status)
    return Trial(model, method, best, log_likelihood(best, method.cutoff))
