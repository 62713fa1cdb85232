"""The monitor of one axis."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pmfid._estimate import Estimate
from pmfid._stage import EDGE, Inputs, Watcher
from pmfid.elementary import solve
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import INPUT_GAIN, forces_of
from pmfid.estimators.iv import IV
from pmfid.estimators.known import Known, Posterior
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.monitor.base import AxisMonitor
from pmfid.monitor.calibration import Calibration
from pmfid.monitor.cause import Cause, ChangeEvidence, explain, start_of
from pmfid.monitor.detector import make_detection
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS, WATCHING, Alarm, Event, Settled, Watch
from pmfid.monitor.scores import Blocks, ScoreFilter, Scoring, start_blocks
from pmfid.monitor.states import Disturbed, Watched
from pmfid.monitor.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Floats

#: Reasons of the state CANNOT_TELL, by the numbers of the watcher.
REASONS = (
    "",
    "the estimate has not started",
    "poor excitation",
    "standstill",
    "the motion contains no information on the parameters",
)


#: Status bits of estimates that are not used.
UNUSABLE = Status.NOT_AN_ESTIMATE | Status.FALLBACK


@dataclass(repr=False)
class WatchedAxis(AxisMonitor):
    """The data of a `Monitor` on its axis, and its decisions on each block."""

    estimator: RecursiveEstimator
    calibration: Calibration
    watch: Watch = field(default_factory=Watch)
    known: Known | None = None

    def __post_init__(self) -> None:
        theta = self.calibration.theta
        self.threshold = self.calibration.chance.threshold(self.watch.mtbf_hours)
        self._front = like(IV, self.estimator, prefilter_zeros=None)
        self._noise = self._front.noise()
        self._filter = ScoreFilter(self._front, theta, left_out=self.calibration.left_out)
        sizes = {"p": theta.size, "width": self._filter.scoring.width, "starts": make_detection(theta.size).rows}
        self._own, self._rest = Watched.empty(1, **sizes), Disturbed.empty(1, **sizes)
        self._start_at(theta)
        self._inputs, self._flagged, self._warmer, self._block_warmer = Inputs(), 0, 0.0, 0.0

    @cached_property
    def watcher(self) -> Watcher:
        """The kernel that makes the decisions of all axes with this configuration."""
        work, block_time = self.calibration.work, self._front.settle_samples * self._front.dt
        return Watcher(
            self.calibration.scale.norms,
            work.scale.norms,
            make_detection(self.calibration.theta.size),
            (work.size, work.offset, work.limit),
            self.threshold,
            block_time,
            max(TUNING.silent_blocks, round(TUNING.silent_time / block_time)),
        )

    def _sizes(self, theta: Floats) -> Floats:
        """Return the noise (n,) at references (n, p), over the noise at the calibration's reference."""
        first = float(self._square(self.calibration.theta[None])[0])
        return np.asarray(np.sqrt(self._square(theta) / max(first, 1e-300)))

    def _square(self, theta: Floats) -> Floats:
        total = np.zeros(len(theta))
        for i, j in np.ndindex(self._noise.shape):
            total = total + theta[:, i] * self._noise[i, j] * theta[:, j]
        return total

    def derive(self, watched: Watched) -> None:
        """Derive sigma, tolerance and waiting time of each axis from the references."""
        watched.sigma[:] = self._sizes(watched.theta)[:, None] * self.calibration.work.scale.sigma
        watched.tolerance[:] = self.watch.tolerance * np.abs(watched.theta) / watched.sigma
        references, axes = np.unique(watched.theta, axis=0, return_inverse=True)
        watched.wait[:] = np.array([start_blocks(self._front, theta) for theta in references], np.int64)[axes.ravel()]

    @property
    def scoring(self) -> Scoring:
        """Rule that makes blocks from samples."""
        return self._filter.scoring

    @property
    def samples(self) -> int:
        return self._inputs.samples

    @property
    def _time(self) -> float:
        """Time of the sample to which the estimate belongs [s]."""
        return (self.samples - 1 - self.estimator.delay) * self.estimator.dt

    def _add_known(self, theta: Floats, std: Floats) -> tuple[Floats, Floats]:
        """Combine a reference (p,) and its standard deviations with the prior information. Both results are (q,)."""
        if self.known is None:
            return theta, std
        found = self.known.combine(Posterior(self._front.names, self._front.units, theta, np.diag(std**2)))
        return found.theta, found.theta_std

    def _refer(self, theta: Floats) -> None:
        """Start to watch for deviations from theta (p,)."""
        self._filter = ScoreFilter(self._front, theta, self._filter, self.calibration.left_out)
        self._start_at(theta)

    def _start_at(self, theta: Floats) -> None:
        """Let the decisions begin at the reference theta (p,)."""
        own, rest = self._own, self._rest
        own.theta[0] = rest.model[0] = theta
        self.derive(own)
        own.waiting[:] = own.wait
        own.silence[:] = own.members[:] = own.units[:] = 0
        own.opened[:] = own.opening[:] = own.begun[:] = own.statistic[:] = own.line[:] = own.detection[:] = 0.0
        rest.gathered[:] = rest.refined[:] = rest.crossed[:] = rest.suspected[:] = 0

    def _take_reference(self, theta: Floats) -> None:
        self._refer(theta)
        self._rest.since[0] = self._time

    def _on_block(self, rows: Floats, lost: NDArray[np.uint8], estimate: Estimate) -> list[Event]:
        """Return the events after a block (1, width). `lost` (1,) is true if all samples of the block were
        disturbed."""
        watcher, own = self.watcher, self._own
        rows, information = watcher.informed(own, rows, bool(lost[0]))
        if self.state == SETTLING:
            return self._settle(rows, information, estimate)
        whole, unit = watcher.whole(own, rows, information, self._time)
        events = [] if self.state == SUSPICIOUS else self._look_around(estimate)
        return [*events, *self._on_unit(unit, estimate)] if whole else events

    def _on_unit(self, unit: Floats, estimate: Estimate) -> list[Event]:
        own, rest, watcher = self._own, self._rest, self.watcher
        information = watcher.counted(own, rest, unit)
        if self.state == SUSPICIOUS:
            rest.gathered[0] += min(information, TUNING.most_information)
            rest.suspected[0] += 1
            return self._alarm(estimate)
        if not watcher.crossed(own, information, estimate.status):
            return []
        rest.gathered[0] = min(information, TUNING.most_information)
        rest.crossed[0], rest.suspected[0] = own.statistic[0], 1
        self.estimator.open_memory(TUNING.axis_keep)
        return [
            *self._enter(SUSPICIOUS, "a deviation was found, and its cause is not clear yet"),
            *self._alarm(estimate),
        ]

    def _look_around(self, estimate: Estimate) -> list[Event]:
        """Update the state, which depends on whether changes can be detected now."""
        wanted, reason = self.watcher.looked(self._own, estimate.status)
        return self._enter(STATES[wanted], REASONS[reason])

    def _alarm(self, estimate: Estimate) -> list[Event]:
        """Return an alarm once the changes are clear. A deviation that is surely within the tolerance ends the
        suspicion."""
        evidence, gathered = self._evidence(estimate), float(self._rest.gathered[0])
        if evidence is None or gathered < TUNING.cause_information:
            return []
        cause = self._explain(evidence, self.reference)
        ends = cause.largest <= self.watch.tolerance
        growth = max(TUNING.cause_units, TUNING.cause_blocks / max(self.calibration.work.size, 1.0)) / gathered
        if not ends and growth > 1 and cause.is_open(growth):
            return []
        if ends or cause.size <= self.watch.tolerance:
            self._own.detection[:] = 0.0
            return self._enter(WATCHING, "the deviation is within the tolerance")
        alarm, rest = self._make_alarm(cause), self._rest
        rest.refined[0] = 0  # the information since the suspicion counts for the new model
        goes_on = self._note_course(alarm, cause.deviation)
        way = cause.deviation / self._own.sigma[0] ** 2
        rest.slow[0] = alarm.relative * way / (way @ cause.deviation) if goes_on else 0.0
        reason = f"measuring the new {' and '.join(cause.names)}"
        return [*([] if goes_on else [alarm]), *self._enter(SETTLING, reason)]

    def _note_course(self, alarm: Alarm, deviation: Floats) -> bool:
        """Note whether a change is slow, and return whether it continues the slow change of the last alarm.

        The line of a slow change reaches the deviation. A step after a slow change is far beyond this line.
        After a pause, the mean rate is much lower, and the change is another one. If the last alarm did not look slow,
        its deviation must have grown before it for as long as this rate says.
        """
        own, rest = self._own, self._rest
        units, i = float(own.units[0]), int(np.argmax(np.abs(deviation / own.sigma[0])))
        total, square = own.line[0, :, i]
        reached = units * total * own.sigma[0, i] / (square * deviation[i]) if square > 0 else 0.0
        slow = self._is_slow() and reached > TUNING.axis_pace
        cause = crc32(f"{alarm.parameter} {alarm.change > 0}".encode())
        rate = 3600 * alarm.relative / (self._time - float(rest.since[0]))
        least = TUNING.axis_pace * abs(float(rest.rate[0]))
        same = abs(rate) > least if least else float(rest.grown[0]) > TUNING.axis_pace * units / 2
        goes_on = slow and cause == rest.cause[0] and same
        rest.grown[0] = round(units * reached / 3)  # whole units, because BLAS changes bits
        rest.cause[0], rest.rate[0] = cause, rate if slow else 0.0
        return bool(goes_on)

    def _is_slow(self) -> bool:
        """Return whether a line since the reference explains the units better than a step among the last units."""
        own, p = self._own, self.reference.size
        units, _ = self._rest.recent(0, int(own.units[0]))
        x, w = replace(self.calibration.work.scale, sigma=own.sigma[0]).standardise(Blocks.from_rows(units, p))
        sums, known = (np.cumsum(part[::-1], axis=0) for part in (x, w))
        edge = EDGE * float(own.units[0]) ** 2
        line = own.line[0, 0] ** 2 / (own.line[0, 1] + edge)
        return bool(np.max(line) > np.max(sums**2 / (known + EDGE)))

    def _make_alarm(self, cause: Cause) -> Alarm:
        units, begun = self._rest.recent(0, int(self._own.units[0]))
        latest = max(0, len(units) - int(self._rest.suspected[0])) + TUNING.cause_transition
        start = start_of(Blocks.from_rows(units, self.reference.size), cause.deviation, latest)
        gain, moved = float(self._rest.gain[0]), (INPUT_GAIN, *forces_of(self.estimator.equation))
        return Alarm(
            self._time,
            max(0.0, float(begun[start])),
            tuple(one.scale(gain) if one.parameter in moved else one for one in cause.changes),
            float(self._rest.crossed[0]),
            self.threshold,
            cause.others,
            self.watch.tolerance,
        )

    def _evidence(self, estimate: Estimate) -> ChangeEvidence | None:
        """Return the evidence of the estimate on the cause, or None while no estimate exists.

        The evidence excludes the constant offset of unmodelled effects. Its covariance includes their spread.
        """
        work = self.calibration.work
        found = ChangeEvidence(
            self._remove_warmth(estimate) - work.offset, np.array(estimate.theta_cov) + np.diag(work.spread**2)
        )
        silent = estimate.status & UNUSABLE or not np.all(np.isfinite(np.r_[found.theta, found.covariance.ravel()]))
        return None if silent else found

    def _settle(self, rows: Floats, information: float, estimate: Estimate) -> list[Event]:
        """Make the estimate the model. Later the model, corrected by the blocks, becomes the reference.

        The model follows the estimate meanwhile, because a model with other friction reverses at other instants, which
        hides a part of its error.
        """
        rest = self._rest
        rest.gathered[0] += information
        usable = not estimate.status & UNUSABLE and self.plausible(self._remove_warmth(estimate))
        if rest.refined[0]:
            self._collect(rows)
            if rest.gathered[0] >= TUNING.reference_information:
                return self._correct()
        elif rest.gathered[0] >= TUNING.model_information and usable:
            rest.before[0] = self.reference
            self.estimator.open_memory(1.0)  # standard errors need not remember the change
            self._refer(self._remove_warmth(estimate))
            rest.settled[:], rest.refined[0] = 0.0, 1
        if rest.refined[0] and usable:
            rest.model[0] = self._remove_warmth(estimate)
        return []

    def _collect(self, rows: Floats) -> None:
        """Add a block (1, width) to the sums, with its score about the reference in place of the model."""
        block = Blocks.from_rows(rows.copy(), self.reference.size)
        for row, change in zip(block.cross[0], self._rest.model[0] - self.reference, strict=True):  # BLAS changes bits
            block.score[0] += row * change
        self._rest.settled[0, : block.score.size] += block.score[0]
        self._rest.settled[0, block.score.size :] += rows[0, block.score.size :]

    def _correct(self) -> list[Event]:
        """Correct the model by the blocks. The result is the reference."""
        model, blocks = self.reference, Blocks.from_rows(self._rest.settled, self.reference.size)
        cross = blocks.cross[0] + 1e-12 * np.eye(model.size)
        theta = model + solve(cross, blocks.score[0])
        size = float(self._sizes(model[None])[0])
        std = size * self.calibration.scale.sigma / np.sqrt(float(self._rest.gathered[0]))
        if not self.plausible(theta):
            theta = model
        # Scores are linear in the deviation of the model, so a large correction has an error of second order.
        moved = np.abs(theta - model)
        std = np.hypot(std, moved**2 / np.maximum(np.maximum(np.abs(theta), moved), np.finfo(float).tiny))
        return self._end_settling(theta, std, self._judge_again(theta, std, cross, blocks.square[0]))

    def _end_settling(self, theta: Floats, std: Floats, cause: Cause) -> list[Event]:
        """Make theta (p,) the reference, with standard errors and the cause of its difference from the last one."""
        rest = self._rest
        self._refer(theta)
        (now, errors), (before, _) = self._add_known(theta, std), self._add_known(rest.before[0].copy(), std)
        if self.known is not None and self.known.find_gain:
            rest.gain[0] = float(now[-1]) / self.estimator.equation.input_gain
        change, elapsed = float(rest.slow[0] @ (theta - rest.before[0])), self._time - float(rest.since[0])
        rate, rest.since[0] = 3600 * change / elapsed if change else None, self._time
        event = Settled(self._time, now, errors, before, self._gain(cause), rate, cause.changes, cause.others)
        return [event, *self._enter(WATCHING, "")]

    def _judge_again(self, theta: Floats, std: Floats, cross: Floats, square: Floats) -> Cause:
        """Return the changes from the previous reference to theta (p,), for which the blocks since the alarm have the
        sums `cross` and `square` (p, p). They give the correlations of the errors."""
        inverse = np.linalg.inv(cross)
        spread = inverse @ square @ inverse.T
        size = std / np.sqrt(np.maximum(np.diagonal(spread), np.finfo(float).tiny))
        covariance = spread * np.outer(size, size) + np.diag(self.calibration.work.spread**2)
        return self._explain(ChangeEvidence(theta, covariance), self._rest.before[0].copy())

    def _explain(self, evidence: ChangeEvidence, theta: Floats) -> Cause:
        """Return the changes from theta (p,) that explain the evidence best. Given parameters do not change."""
        fixed = () if self.known is None else tuple(self.known.given)
        return explain(evidence, theta, self.estimator.equation, self.watch.tolerance, fixed)

    def _gain(self, cause: Cause) -> tuple[float, float, float] | None:
        """Return the new gain, its standard deviation and the previous gain if only the gain has changed, else None."""
        if cause.names != (INPUT_GAIN,) or self.known is not None:
            return None
        gain, change = self.estimator.equation.input_gain, cause.changes[0]
        return gain + change.change, change.std, gain

    def _remove_warmth(self, estimate: Estimate) -> Floats:
        """Return the estimated parameters (p,), with the friction of the mean temperature of normal work."""
        warmth, theta = self.calibration.warmth, np.array(estimate.theta)
        return theta if warmth is None else theta / warmth.factor(self._warmer)

    def _follow_temperature(self, warmer: float) -> None:
        """Simulate the next block with the friction of a temperature above the mean of normal work."""
        warmth, self._block_warmer = self.calibration.warmth, warmer
        self._filter.move(self._rest.model[0] * (1.0 if warmth is None else warmth.factor(warmer)))

    def plausible(self, theta: Floats) -> bool:
        """Return whether a machine can have the parameters (p,), with a positive mass and without negative friction."""
        equation = self.estimator.equation
        never_negative = np.array(equation.positive)
        return bool(np.all(np.isfinite(theta)) and theta[equation.leading] > 0 and np.all(theta[never_negative] >= 0))
