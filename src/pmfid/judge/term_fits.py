"""Models of one drive on one record, each begun where another one has ended."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.configuration import changed, like
from pmfid.estimators.difference import Difference, first_speed, least, rms
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.iv import IV
from pmfid.estimators.lacks import Change
from pmfid.estimators.likelihood import GIVEN_AWAY, NOISE_FLOOR, SHRINKING, Best, climb
from pmfid.estimators.output_error import HOPELESS, OE, STRIBECK_SPEEDS
from pmfid.estimators.window_choice import FEWEST, FOLDS, SHORTEST, predicted_elsewhere
from pmfid.judge.free_run import drive_run
from pmfid.judge.term_trials import Trial, carried, log_likelihood
from pmfid.models.drive import Drive, EquationModel
from pmfid.models.equation import ESTIMATE
from pmfid.types import Floats

#: Parts of a sample in which the motions of a search are simulated at most: with 2 the likelihoods of a cart under a
#: random binary input are within 0.1 of those with 16, and with 1 within 4.
MOST_PARTS = 3
#: Relative tolerance of least squares on the way.
ROUGHLY = 1e-4
#: Noise [counts] below which a maximum of the likelihood may be a local one beside the right model.
SUSPICIOUS = 0.25
#: A step up the likelihood that gains less is the last one.
SETTLED = 0.1
#: Stribeck speeds that are gone on from.
MOST_SPEEDS = 2
#: Pitches of the travel by which a pitch is tried more and less.
CLOSER = (0.1, 0.05, 0.025, 0.0125)
#: Windows of each part that the others predict it with.
WINDOWS = 4


@dataclass(frozen=True)
class Bench:
    """What all models are fitted to: u, counts (n,), by a method whose model is that to begin with. other: u, counts of
    another record of the same machine, to predict; None: the models predict parts of the first from the others."""

    method: IntervalML
    u: Floats
    counts: NDArray[np.int64]
    other: tuple[Floats, NDArray[np.int64]] | None = None

    def first(self, model: Drive) -> Trial:
        """Begun with instrumental variables. Raises NotIdentifiableError."""
        method = like(IntervalML, self.method, model=model)
        difference, q, status = method.followed(self.u, self.counts)
        return trial_of(method, model, difference, q, status)

    def further(self, trial: Trial, change: Change) -> Trial:
        """The model with some of its fields changed, begun at the parameters of the one before."""
        return self.fitted(changed(trial.model, change), trial)

    def tuned(self, trial: Trial, key: str) -> Trial:
        """The same with the period `key` of [model] that leaves least squares the least, near the one that it has."""
        travel = float(np.ptp(trial.difference.y))
        number = travel / float(getattr(trial.model, key))
        left, theta = self._left(trial.model, trial.theta, trial)
        for apart in CLOSER:
            for side in (-apart, apart):
                own = changed(trial.model, {key: travel / (number + side)})
                with suppress(NotIdentifiableError):
                    other, moved = self._left(own, theta, trial)
                    if other < left:
                        left, theta, number = other, moved, number + side
                        break
        model = changed(trial.model, {key: travel / number})
        found = self._from_squares(model, theta, trial)[-1]
        return max(trial, found, key=lambda one: one.log_likelihood)

    def _left(self, model: Drive, theta: Floats, trial: Trial) -> tuple[float, Floats]:
        """Root mean square that a model leaves behind the high-pass [counts], and its parameters (p,), from theta."""
        method = like(IntervalML, self.method, model=model)
        difference, q = _behind(method, theta, trial.difference)
        q = least(difference, q, [ROUGHLY])
        return rms(difference(q)), np.asarray((q * difference.scale)[:-2])

    def fitted(self, model: Drive, trial: Trial) -> Trial:
        """A model begun at the parameters of another. Raises NotIdentifiableError where nothing settles."""
        equation, before = model.equation, trial.model.equation
        theta = carried(before, trial.theta, equation)
        begun = list[Trial]()
        if len(equation.further) <= len(before.further):
            begun = [self._from(model, theta, trial)]
            if begun[0].best.clean or not equation.further:
                return begun[0]
        found = begun + [
            self._from(model, np.r_[one.theta, speed], one) for speed, one in self._at_speeds(model, theta, trial)
        ]
        if not found:
            raise NotIdentifiableError("no Stribeck speed settles: record more of slow motion")
        return max(found, key=lambda one: one.log_likelihood)

    def _at_speeds(self, model: Drive, theta: Floats, trial: Trial) -> list[tuple[float, Trial]]:
        """Known Stribeck speeds, and the model at them: those that leave the least."""
        found = []
        for speed in trial.usual_speed * np.array(STRIBECK_SPEEDS):
            try:
                known = replace(model, stribeck=float(speed))
                found.append((float(speed), self._from(known, theta[:-1], trial, hasty=True)))
            except NotIdentifiableError:
                continue
        return sorted(found, key=lambda one: -one[1].log_likelihood)[:MOST_SPEEDS]

    def _from(self, model: Drive, theta: Floats, trial: Trial, hasty: bool = False) -> Trial:
        """A model from theta (p,), and from where the motion of another trial starts: up the likelihood where that is
        within the counts, for least squares would go astray there, or from least squares on. hasty: by one of these."""
        method, found = like(IntervalML, self.method, model=model), list[Trial]()
        if trial.best.noise is not None:
            difference = _quick(method.at(theta, trial.difference.u, trial.difference.y))
            start = (trial.best.q * trial.difference.scale)[-2:]
            q = np.maximum(np.r_[theta, start] / difference.scale, difference.lower)
            found.append(_at_top(method, model, difference, q, trial.best.status, hasty))
        if not found or not (hasty or found[0].best.clean):
            try:
                found += self._from_squares(model, theta, trial)
            except NotIdentifiableError:
                if not found:
                    raise
        return max(found, key=lambda one: one.log_likelihood)

    def _from_squares(self, model: Drive, theta: Floats, trial: Trial) -> list[Trial]:
        """From least squares on. Where a force comes again along the travel, the motion of a model without it may be a
        period off: there instrumental variables, which read the place from the counts, know where to start."""
        method, starts = like(IntervalML, self.method, model=model), [theta]
        if any(not term.shape.of_speed for term in model.equation.shaped if term.shape):
            known = replace(model, stribeck=None) if model.stribeck == ESTIMATE else model
            fit = like(IV, method, model=known).fit(self.u, self.counts)
            starts.insert(0, carried(known.equation, fit.theta, model.equation))
            starts[0][len(model.equation.names) :] = theta[len(model.equation.names) :]
        found = list[Trial]()
        for start in starts:
            difference, q = _followed(method, start, trial.difference)
            found.append(trial_of(method, model, difference, q, trial.best.status))
            if found[-1].best.clean:
                break
        return found

    def by_chance(self, trial: Trial) -> float:
        """The error that `elsewhere` would have if the model were right: that of its own motion through this encoder,
        over parts of the record. Their starts are read through it, and that may be most of an error."""
        x, resolution = trial.difference.motion(trial.best.q)[0], trial.difference.resolution
        return self._over_parts(trial, resolution * (np.floor(x / resolution) + 0.5))

    def elsewhere(self, trial: Trial) -> float:
        """Error of free runs over what a model was not fitted to [unit of y]: another record, or thirds of this one
        with what the others say of the model. Infinite where there is no run."""
        if self.other is None:
            return self._over_parts(trial, trial.difference.y)
        equation = trial.model.equation
        linear = EquationModel(equation.known_at(trial.theta[len(equation.names) :]))
        method, theta = like(OE, trial.method, model=linear), trial.theta[: len(equation.names)]
        with suppress(UsageError):
            return drive_run(method, theta, *self.other, "the other record").rmse
        return math.inf

    def _over_parts(self, trial: Trial, y: Floats) -> float:
        equation, n = trial.model.equation, self.u.size
        known = equation.known_at(trial.theta[len(equation.names) :])
        method = like(IntervalML, trial.method, model=EquationModel(known))
        theta = trial.theta[: len(equation.names)]
        difference = _quick(method.at(theta, trial.difference.u, y))
        scaled = np.maximum(theta / difference.scale[:-2], difference.lower[:-2])
        length = max(shortest_part(method), n * (FOLDS - 1) // FOLDS // WINDOWS)
        return predicted_elsewhere(difference, scaled, method.cutoff, length)


def shortest_part(method: IntervalML) -> int:
    """Samples of a part of a record that can be predicted: in less there is little but its start."""
    return max(FEWEST, math.ceil(SHORTEST / (method.cutoff * method.dt)))


def trial_of(method: IntervalML, model: Drive, difference: Difference, q: Floats, status: int) -> Trial:
    """At the largest likelihood from the least squares q (q,), where that is within the counts."""
    if difference.pole > 0 or rms(difference(q)) > difference.explained:
        best = Best(difference, q, q, None, status)
        return Trial(model, method, best, log_likelihood(best, method.cutoff))
    return _at_top(method, model, difference, q, status)


def _followed(method: IntervalML, theta: Floats, record: Difference) -> tuple[Difference, Floats]:
    """The difference of a record as `Following.followed` has it, and its least squares from theta (p,), roughly: of
    many models all but one are to be thrown away."""
    behind, q = _behind(method, theta, record)
    q, direct = least(behind, q, [ROUGHLY]), replace(behind, pole=0.0)
    if rms(behind(q)) > HOPELESS * direct.explained:
        return behind, q
    closer = least(direct, q, [ROUGHLY])
    return (direct, closer) if rms(direct(closer)) <= direct.explained else (behind, q)


def _quick(difference: Difference) -> Difference:
    """The same with no more parts of a sample than tell models from each other."""
    return replace(difference, parts=min(difference.parts, MOST_PARTS))


def _behind(method: IntervalML, theta: Floats, record: Difference) -> tuple[Difference, Floats]:
    """The difference of a record behind the high-pass, and q (q,) of theta (p,) at the first count."""
    behind = replace(_quick(method.at(theta, record.u, record.y)), pole=method.cutoff)
    begin = np.r_[theta, record.y[0], first_speed(record.y, record.dt, method.cutoff, record.resolution)]
    return behind, np.maximum(begin / behind.scale, behind.lower)


@np.errstate(over="ignore", invalid="ignore")  # far from the counts their probability is beyond numbers
def _at_top(
    method: IntervalML, model: Drive, difference: Difference, q: Floats, status: int, hasty: bool = False
) -> Trial:
    """At a maximum of the likelihood near q (q,); by way of a noise that shrinks where it may be a local one, unless it
    is to be hasty."""
    found = climb(difference, q, None, SETTLED)
    if not hasty and GIVEN_AWAY * NOISE_FLOOR < found[2] < SUSPICIOUS:
        place = q
        for noise in SHRINKING:
            place = climb(difference, place, noise, SETTLED)[1]
        found = min(found, climb(difference, place, None, SETTLED), key=lambda one: one[0])
    best = Best(difference, q, found[1], found[2], status)
    return Trial(model, method, best, log_likelihood(best, method.cutoff))
