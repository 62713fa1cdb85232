"""The monitor: estimates sample by sample, and says when a parameter changed."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from operator import index

import numpy as np

from pmfid._estimate import Estimate
from pmfid.estimators.configuration import like
from pmfid.estimators.facts import INPUT_GAIN, forces_of
from pmfid.estimators.iv import IV
from pmfid.estimators.known import Known, Posterior, Seen, told_by
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.monitor.calibration import Calibration
from pmfid.monitor.cause import TRANSITION, Cause, explain, sized
from pmfid.monitor.events import (
    CANNOT_TELL,
    SETTLING,
    STARTING,
    SUSPICIOUS,
    WATCHING,
    Alarm,
    Event,
    Outlier,
    Settled,
    StateChange,
    Watch,
)
from pmfid.monitor.lost import Lately
from pmfid.monitor.scores import Blocks, Scale, ScoreFilter
from pmfid.shown import Parameters, Shown, Summary, plain, remarks_of
from pmfid.status import Status
from pmfid.types import Floats

#: Blocks that an alarm looks back on.
LOOK_BACK = 64
#: A block with less of the average information tells nothing.
INFORMATIVE = 0.05
#: Time without such a block after which nothing can be told [s], at least so many blocks.
SILENT_TIME, SILENT_BLOCKS = 2.0, 6
#: Information, in average blocks, until the estimate after an alarm serves as a model, and then as a reference.
MODEL_INFORMATION, REFERENCE_INFORMATION = 15.0, 60.0
#: Information after which a cause that explains so much of what is to explain is named, and after which the best is.
CAUSE_INFORMATION, CAUSE_SHARE, CAUSE_LATEST = 4.0, 0.95, 8.0
#: A single block counts for no more: where the model is wrong, it errs in every block in another way.
MOST_INFORMATION = 1.5
#: What is kept at the first suspicion of what was gathered before.
KEEP = 0.003
#: What a flagged sample is told as.
OUTLIERS = {Status.COUNT_JUMP: "counts", Status.INVALID_INPUT: "input"}
NO_ALARM = Status.STARTING | Status.POOR_EXCITATION


@dataclass(repr=False)
class Monitor(Shown):
    """Watches one axis.

    estimator: recursive, at its start; calibration: of its configuration and the reference parameters. `step` takes one
    sample. At the first suspicion the estimator's memory is opened: what it gathers from then on is of the new plant,
    and must not be thrown away when the cause is clear, which is when the alarm comes. The new value, once known, is
    the reference, so every change is told once.

    known: what is known of the parameters beside the samples. Values that are given stay, so no change is one of them;
    where the gain of the input is to be found, the estimator has that of the reference, and what is told is of the
    machine with the gain that it has now.
    """

    estimator: RecursiveEstimator
    calibration: Calibration
    watch: Watch = field(default_factory=Watch)
    known: Known | None = None
    state: str = field(default=STARTING, init=False)
    samples: int = field(default=0, init=False)
    statistic: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.threshold = self.calibration.tails[self.watch.detector].threshold(self.watch.mtbf_hours)
        p = self.calibration.theta.size
        self._detector = self.calibration.detectors(self.estimator)[self.watch.detector]
        self._front = like(IV, self.estimator, prefilter_zeros=None)
        self._noise = self._front.noise()
        self._filter = ScoreFilter(self._front, self.calibration.theta, left_out=self.calibration.left_out)
        self._refer(self.calibration.theta)
        self._sum = Blocks(np.zeros((1, p)), np.zeros((1, p, p)), np.zeros((1, p, p)))
        self._gain = 1.0  # of the input, over that of the estimator
        self._counts, self._zero, self._lost, self._flagged = 0, 0, False, Status(0)
        self._lately = Lately(self.estimator)
        self._silent_blocks = max(SILENT_BLOCKS, round(SILENT_TIME / self._block_time))

    @property
    def reference(self) -> Floats:
        """(p,) parameters that deviations are measured from."""
        return self._filter.theta

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters that are told: the estimator's, and the gain of the input where it is found."""
        return told_by(self.estimator, self.known).names

    @property
    def units(self) -> tuple[str, ...]:
        return told_by(self.estimator, self.known).units

    @property
    def _parameters(self) -> Parameters:
        """What deviations are measured from, with the standard deviations of one block."""
        return Parameters(self.estimator.names, self.estimator.units, self.reference, self._seen.sigma)

    def summary(self) -> Summary:
        watch = self.watch
        title = (
            f"monitor by {watch.detector}: {self.state} after {self.samples} samples, "
            f"statistic {self.statistic:.3g} of {self.threshold:.3g}; the reference, ± of one block:"
        )
        return self._parameters.summary(
            title,
            remarks_of(
                (),
                [f"a false alarm in {watch.mtbf_hours:g} h on average; {100 * watch.tolerance:g} % off is no change"],
            ),
        )

    def columns(self) -> dict[str, object]:
        """A row for each parameter of the reference."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        return {
            "state": self.state,
            "samples": self.samples,
            "statistic": plain(self.statistic),
            "threshold": plain(self.threshold),
            "detector": self.watch.detector,
            "mtbf_hours": self.watch.mtbf_hours,
            "tolerance": self.watch.tolerance,
            "reference": self._parameters.content,
        }

    def told(self, estimate: Estimate) -> Estimate | Seen:
        """An estimate with what is known beside it."""
        return estimate if self.known is None else Seen(self.known, estimate)

    def _beside(self, theta: Floats, std: Floats) -> tuple[Floats, Floats]:
        """A reference (p,) and its standard deviations with what is known, each (q,)."""
        if self.known is None:
            return theta, std
        found = self.known.of(Posterior(self._front.names, self._front.units, theta, np.diag(std**2)))
        return found.theta, found.theta_std

    @property
    def _block_time(self) -> float:
        return self._front.settle_samples * self._front.dt

    def step(self, u: float, counts: int) -> tuple[Estimate, list[Event]]:
        """One sample as in `RecursiveEstimator.step`: the estimate, and what there is to tell.

        After a sample that was lost, u not finite, the counts go on from the last: whatever the counter did meanwhile,
        no speed explains it.
        """
        lost = not math.isfinite(u)
        if self._lost and not lost:
            self._zero = self._counts - counts
        counts = self._counts if lost else counts + self._zero
        self._lost, self._counts = lost, counts
        self._lately.note(u, counts)
        estimate = self.estimator.step(u, counts)
        self.samples += 1
        block = self._filter.step(u, counts)
        events = [] if lost else self._outliers(Status(estimate.status))
        return estimate, events if block is None else events + self._on_block(block, estimate)

    def rebase(self, counts: int) -> None:
        """The counter was set anew: it would have read `counts` at the last sample. Raises TypeError for no integer."""
        self._zero = self._counts - index(counts)

    def _outliers(self, status: Status) -> list[Event]:
        """Once for what lasts over several samples."""
        found = [signal for bit, signal in OUTLIERS.items() if bit in status and bit not in self._flagged]
        self._flagged = status
        return [Outlier(self._time, signal) for signal in found]

    def skip(self, samples: int) -> list[Event]:
        """Samples that were lost: the filters settle anew, and time goes on. What there is to tell."""
        few, events = min(samples, self._front.settle_samples), []
        for _ in range(few):
            events += self.step(float("nan"), self._counts)[1]
        self.samples += samples - few
        return events

    @property
    def longest(self) -> int:
        """So many lost samples are for `between`, more for `skip`."""
        return self._lately.longest

    def between(self, missing: int, u: float, counts: int) -> list[Event]:
        """A few samples that were lost before one of u and counts: what most likely stood there (`Lately.guess`), and
        nothing is learnt for a while where a held input switched in one of them, nobody knows which. Where nothing is
        known of them, as `skip`. What there is to tell."""
        guess = None if self._lost else self._lately.guess(missing, u, counts + self._zero)
        if guess is None:
            return self.skip(missing)
        if guess.doubt:
            self.estimator.doubt(guess.doubt)
            self._filter.doubt(guess.doubt)
        events = list[Event]()
        for moment in guess.samples:
            events += self.step(moment[0], moment[1] - self._zero)[1]
        return events

    def _refer(self, theta: Floats) -> None:
        """Starts to watch for deviations from theta (p,)."""
        first = self.calibration.theta
        size = np.sqrt(float(theta @ self._noise @ theta) / max(float(first @ self._noise @ first), 1e-300))
        self._scale, self._work = _rescaled(self.calibration.scale, size), self.calibration.work
        if self._work is not None:
            self._work = replace(self._work, scale=_rescaled(self._work.scale, size))
        self._seen = self._scale if self._work is None else self._work.scale
        self._filter = ScoreFilter(self._front, theta, self._filter, self.calibration.left_out)
        self._tolerance = self.watch.tolerance * np.abs(theta) / self._seen.sigma
        self._detection = self._detector.start(theta.shape)
        self._recent: deque[Blocks] = deque(maxlen=LOOK_BACK)
        self._begun: deque[float] = deque(maxlen=LOOK_BACK)
        self._open: list[Blocks] = []
        self._opened = 0.0
        self._silence, self._gathered, self._refined, self._crossed, self._suspected = 0, 0.0, False, 0.0, 0
        self.statistic = 0.0

    def _on_block(self, block: Blocks, estimate: Estimate) -> list[Event]:
        information = float(self._scale.information(block)[0])
        self._silence = 0 if information > INFORMATIVE else self._silence + 1
        block = block if self._work is None else self._work.centred(block)
        if self.state == SETTLING:
            return self._settle(block, information, estimate)
        unit = self._unit(block, information)
        events = [] if self.state == SUSPICIOUS else self._look_around(estimate)
        return events if unit is None else events + self._on_unit(unit, estimate)

    def _unit(self, block: Blocks, information: float) -> Blocks | None:
        """The unit that a block completes; without units of work each block is one."""
        if not self._open:
            self._begun.append(self._time - self._block_time)
        self._open.append(block)
        self._opened += information
        if self._work is not None and self._opened < self._work.size:
            return None
        whole, self._open, self._opened = Blocks.joined(self._open).total(), [], 0.0
        return whole

    def _on_unit(self, unit: Blocks, estimate: Estimate) -> list[Event]:
        counted = unit if self._work is None else self._work.weighed(unit)
        x, w = (part[0] for part in self._seen.standardise(counted))
        information = float(self._seen.information(unit)[0])
        self._recent.append(unit)
        self._detection, statistic = self._detector.update(self._detection, x, w, self._tolerance)
        self.statistic = float(statistic)
        if self.state == SUSPICIOUS:
            self._gathered += min(information, MOST_INFORMATION)
            self._suspected += 1
            return self._alarm(estimate)
        crossed = self.statistic > self.threshold and information > INFORMATIVE
        if not crossed or estimate.status & NO_ALARM:
            return []
        self._gathered = min(information, MOST_INFORMATION)
        self._crossed, self._suspected = self.statistic, 1
        self.estimator.open_memory(KEEP)
        return [*self._enter(SUSPICIOUS, "a deviation, its cause is not clear yet"), *self._alarm(estimate)]

    def _look_around(self, estimate: Estimate) -> list[Event]:
        """Whether there is anything to tell from."""
        if estimate.status & Status.STARTING:
            return self._enter(STARTING, "the estimate has not started")
        if estimate.status & Status.POOR_EXCITATION:
            return self._enter(CANNOT_TELL, "poor excitation")
        if self._silence >= self._silent_blocks:
            standing = estimate.status & Status.STANDSTILL
            return self._enter(CANNOT_TELL, "standstill" if standing else "the motion tells nothing")
        if self._silence == 0:
            return self._enter(WATCHING, "")
        return []

    def _enter(self, state: str, reason: str) -> list[Event]:
        if state == self.state:
            return []
        self.state = state
        return [StateChange(self._time, state, reason)]

    @property
    def _time(self) -> float:
        return (self.samples - 1) * self.estimator.dt

    def _alarm(self, estimate: Estimate) -> list[Event]:
        cause = self._cause(estimate)
        clear = self._gathered >= CAUSE_INFORMATION and cause.share >= CAUSE_SHARE
        if not clear and self._gathered < CAUSE_LATEST:
            return []
        if abs(cause.relative) <= self.watch.tolerance:
            self._detection = self._detector.start(self.reference.shape)
            return self._enter(WATCHING, "the deviation is within the tolerance")
        begun = self._begun[cause.start]
        units = dict(zip(self._front.names, self._front.units, strict=True))
        scale = self._gain if cause.name in (INPUT_GAIN, *forces_of(self._front.equation)) else 1.0
        alarm = Alarm(
            self._time,
            max(0.0, begun),
            cause.name,
            units.get(cause.name, ""),
            scale * cause.change,
            scale * cause.std,
            cause.relative,
            self._crossed,
            self.threshold,
        )
        self._gathered, self._refined = 0.0, False
        return [alarm, *self._enter(SETTLING, f"learning the new {cause.name}")]

    def _cause(self, estimate: Estimate) -> Cause:
        latest = max(0, len(self._recent) - self._suspected) + TRANSITION
        names, gain = self._front.names, self.estimator.equation.input_gain
        fixed = () if self.known is None else tuple(self.known.given)
        friction = self._friction()
        recent = Blocks.joined(self._recent)
        cause = explain(recent, self._seen, self.reference, names, gain, latest, fixed, friction)
        if not self._usable(estimate):
            return cause
        found = np.array(estimate.theta), np.array(estimate.theta_cov)
        return sized(cause, *found, self.reference, names, gain, friction)

    def _friction(self) -> Floats | None:
        """(p,) the frictions of the reference; None where there is but one, and where a cause is named within blocks,
        too few to tell all frictions from one of them."""
        equation = self.estimator.equation
        kinds = np.array(equation.positive) & (np.arange(self.reference.size) != equation.leading)
        return np.where(kinds, self.reference, 0.0) if self._work is not None and kinds.sum() > 1 else None

    def _settle(self, block: Blocks, information: float, estimate: Estimate) -> list[Event]:
        """First the estimate becomes the model, then what the blocks say beside it the reference."""
        self._gathered += information
        if self._refined:
            self._sum = self._sum + block
        if not self._refined and self._gathered >= MODEL_INFORMATION and self._usable(estimate):
            self._before = self.reference
            self.estimator.open_memory(1.0)  # the error bars need not remember the change
            self._refer(np.array(estimate.theta))
            self._sum = block - block
            self._refined = True
        elif self._refined and self._gathered >= REFERENCE_INFORMATION:
            return self._settled()
        return []

    def _settled(self) -> list[Event]:
        p = self.reference.size
        theta = self.reference + np.linalg.solve(self._sum.cross[0] + 1e-12 * np.eye(p), self._sum.score[0])
        std = self._scale.sigma / np.sqrt(self._gathered)
        if not self._plausible(theta):
            theta = self.reference
        self._refer(theta)
        now, bars = self._beside(theta, std)
        before, _ = self._beside(self._before, std)
        if self.known is not None and self.known.find_gain:
            self._gain = float(now[-1]) / self.estimator.equation.input_gain
        return [Settled(self._time, now, bars, before), *self._enter(WATCHING, "")]

    def _usable(self, estimate: Estimate) -> bool:
        unusable = Status.STARTING | Status.POOR_EXCITATION | Status.FALLBACK | Status.SETTLING
        return not estimate.status & unusable and self._plausible(np.array(estimate.theta))

    def _plausible(self, theta: Floats) -> bool:
        """Mass positive, frictions not negative."""
        equation = self.estimator.equation
        never_negative = np.array(equation.positive)
        return bool(np.all(np.isfinite(theta)) and theta[equation.leading] > 0 and np.all(theta[never_negative] >= 0))


def _rescaled(scale: Scale, size: float) -> Scale:
    return replace(scale, sigma=size * scale.sigma)
