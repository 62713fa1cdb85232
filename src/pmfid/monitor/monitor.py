"""Monitors, and their treatment of lost samples."""

from __future__ import annotations

import math
import zlib
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid._estimate import Estimate
from pmfid._stage import Inputs
from pmfid.errors import UsageError
from pmfid.estimators.configuration import configuration_of, construct_estimator
from pmfid.estimators.known import Seen, choose_naming
from pmfid.kernel.saved import fleet_layout
from pmfid.monitor.axis import WatchedAxis
from pmfid.monitor.events import Event, Outlier
from pmfid.monitor.saved import IMPLAUSIBLE
from pmfid.monitor.scores import ScoreFilter, reference_kernel
from pmfid.monitor.states import AxisStates, Sampled
from pmfid.monitor.tuning import TUNING
from pmfid.presentation import Parameters, Presentable, Summary, plain, remarks_of
from pmfid.status import Status

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel, ManyKernel
    from pmfid.estimators.known import Known
    from pmfid.estimators.recursive import RecursiveEstimator
    from pmfid.monitor.calibration import Calibration
    from pmfid.monitor.events import Watch


@dataclass(frozen=True)
class GuessedSamples:
    """The guessed input and counts of each lost sample.

    `doubt` is the number of following samples that are not used for learning.
    """

    samples: tuple[tuple[float, int], ...]
    doubt: int


def longest(rate: float) -> int:
    """Return the largest number of lost samples that is guessed. After a longer gap the filters settle again.

    `rate` is the sample period over the time constant of the filters.
    """
    return max(TUNING.monitor_few, round(TUNING.monitor_short / rate))


def guess(last: Inputs, rate: float, missing: int, u: float, counts: int) -> GuessedSamples | None:
    """Return values for the `missing` samples after `last` and before the sample u, counts. Unknown values give None.

    The counts continue the counts of `last`. The guessed inputs lie on a straight line. The guessed counts lie on a
    parabola that starts with the last known speed. In a long gap, this speed is the mean over as many samples as are
    missing. `rate` is the sample period over the time constant of the filters. The values are unknown if an input is
    lost, or if the input leaps although it is not held.
    """
    if last.lost or not (last.known and math.isfinite(u)):
        return None
    n, leap = missing + 1, u - last.input
    held = last.same > TUNING.monitor_held and last.alone > TUNING.monitor_alone
    if not held and abs(leap) > TUNING.monitor_switched * n * last.usual:
        return None
    back = min(n if n > TUNING.monitor_few + 1 else 1, last.fresh - 1)
    speed = (last.counts - last.before(back)) / back if back else 0.0
    bend = (counts - last.counts - speed * n) / (n * (n + back))
    moved = (round(k * (speed + bend * (k + back))) for k in range(1, n))
    between = tuple((last.input + k / n * leap, last.counts + way) for k, way in enumerate(moved, 1))
    return GuessedSamples(between, _doubt(last, rate, missing, leap) if held else 0)


def _doubt(last: Inputs, rate: float, missing: int, leap: float) -> int:
    """Return the number of samples to doubt, because a held input may have switched at any instant of the gap."""
    if abs(leap) * missing * rate / math.sqrt(12) <= TUNING.monitor_doubtful * math.sqrt(last.power):
        return 0
    return missing + round(TUNING.monitor_forgotten / rate)


#: Signal of an outlier, by its status bit.
OUTLIERS = {int(Status.COUNT_JUMP): "counts", int(Status.INVALID_INPUT): "input"}
ANY_OUTLIER = sum(OUTLIERS)


@dataclass(repr=False)
class Monitor(WatchedAxis, Presentable):
    """A monitor that watches one axis for changes.

    The estimator's covariance is reset at the first suspicion. All later samples belong to the new plant, and are still
    needed for the cause and the alarm. The new value, once known, becomes the reference, so each change is reported
    once.

    Parameters
    ----------
    estimator
        Recursive estimator that has not seen a sample.
    calibration
        Calibration for its configuration and the reference parameters.
    watch
        Mean time between false alarms, and tolerance.
    known
        Prior information on the parameters. Given values are constant, so they cannot cause a change. If the input gain
        is unknown, the estimator has the gain of the reference. Reported values belong to the machine with its present
        gain.

    Examples
    --------
    A cart is loaded after 30 s.

    >>> import numpy as np
    >>> from pmfid import RIV, Drive, Encoder
    >>> from pmfid.monitor import Alarm, Monitor, Watch, calibrate
    >>> from pmfid.simulation import CART, make_scenario
    >>> work = make_scenario("moves", seed=1, duration=200.0)
    >>> riv = RIV(Drive(CART.input_gain), Encoder(work.resolution), work.dt, 50.0, forgetting=0.99)
    >>> theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    >>> calibration = calibrate(riv, theta, work.motion.u, work.counts)
    >>> monitor = Monitor(riv, calibration, Watch())
    >>> loaded = make_scenario("moves-mass-step", seed=2, duration=60.0)
    >>> rows = monitor.run(loaded.motion.u, loaded.counts)
    >>> [(event.parameter, round(event.changed_at)) for _, _, event in rows.events if isinstance(event, Alarm)]
    [('mass', 30)]
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the reported parameters, which are the estimator's parameters and an unknown input gain."""
        return choose_naming(self.estimator, self.known).names

    @property
    def units(self) -> tuple[str, ...]:
        return choose_naming(self.estimator, self.known).units

    @property
    def _parameters(self) -> Parameters:
        """The reference, with the standard deviations of one block."""
        return Parameters(self.estimator.names, self.estimator.units, self.reference, self._own.sigma[0].copy())

    def summary(self) -> Summary:
        watch = self.watch
        title = (
            f"monitor: {self.state} after {self.samples} samples, "
            f"statistic {self.statistic:.3g}, threshold {self.threshold:.3g}; reference ± std of one block:"
        )
        return self._parameters.summary(
            title,
            remarks_of(
                (),
                [
                    f"on average one false alarm in {watch.mtbf_hours:g} h; deviations up to "
                    f"{100 * watch.tolerance:g} % are no change"
                ],
            ),
        )

    def columns(self) -> dict[str, object]:
        """A table with a row for each parameter of the reference."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        return {
            "state": self.state,
            "samples": self.samples,
            "statistic": plain(self.statistic),
            "threshold": plain(self.threshold),
            "mtbf_hours": self.watch.mtbf_hours,
            "tolerance": self.watch.tolerance,
            "reference": self._parameters.content,
        }

    def apply_known(self, estimate: Estimate) -> Estimate | Seen:
        return estimate if self.known is None else Seen(self.known, estimate)

    def step(self, u: float, counts: int, temperature: float = math.nan) -> tuple[Estimate, list[Event]]:
        """Take one sample as `RecursiveEstimator.step` does, and return the estimate and the events.

        The last known `temperature` holds until the next one. A sample is lost if u is not finite. The counts after a
        lost sample continue from the last known counts. The counter's change in the gap is ignored.
        """
        own = self._inputs.step(u, counts)
        warmth = self.calibration.warmth
        if warmth is not None and math.isfinite(temperature):
            self._warmer = temperature - warmth.mean
        estimate = self.estimator.step(u, own)
        rows, disturbed = self._filter.sample(u, own)
        events = self._outliers(estimate.status)
        if rows is not None:
            events += self._on_block(rows, disturbed, estimate)
            self._follow_temperature(self._warmer)
        return estimate, events

    def _outliers(self, status: int) -> list[Event]:
        """Return the outliers of a status. An outlier that lasts over several samples is reported once."""
        signals, self._flagged = new_outliers(status, self._flagged) if status & ANY_OUTLIER else [], status
        return [Outlier(self._time, signal) for signal in signals]

    def fresh(self) -> Monitor:
        """Return a new monitor with this configuration."""
        estimator = construct_estimator(type(self.estimator), configuration_of(self.estimator))
        return Monitor(estimator, self.calibration, copy(self.watch), self.known)

    @property
    def further(self) -> str:
        return "" if self.calibration.warmth is None else "temperature"

    def rebase(self, counts: int) -> None:
        """Continue after a reset of the counter, as if the counter had read `counts` at the last sample.

        Raises TypeError if `counts` is not an integer.
        """
        self._inputs.rebase(counts)

    def skip(self, samples: int) -> list[Event]:
        """Skip lost samples, and return the events. Time advances, and the filters settle again."""
        few, events = min(samples, self._front.settle_samples), []
        for _ in range(few):
            events += self.step(float("nan"), 0)[1]
        self._inputs.pass_over(samples - few)
        return events

    def fill_gap(self, missing: int, u: float, counts: int) -> list[Event]:
        """Impute a few samples that were lost before the sample u, counts (`guess`), and return the events.

        If a held input switched in the gap, learning stops for a while, because the instant is unknown. Samples that
        cannot be guessed are skipped as in `skip`.
        """
        last, rate = self._inputs, self.estimator.cutoff * self.estimator.dt
        found = guess(last, rate, missing, u, counts + last.zero) if missing <= longest(rate) else None
        if found is None:
            return self.skip(missing)
        if found.doubt:
            self.estimator.doubt(found.doubt)
            self._filter.doubt(found.doubt)
        events = list[Event]()
        for moment in found.samples:
            events += self.step(moment[0], moment[1] - last.zero)[1]
        return events

    @cached_property
    def configuration_number(self) -> int:
        """Checksum of the configuration."""
        calibration, estimator = self.calibration, self.estimator
        reference, _ = reference_kernel(self._front, calibration.theta.tolist())
        number = zlib.crc32(reference.raw_config(), zlib.crc32(estimator.kernel.raw_config()))
        known = self.known and (dict(self.known.given), dict(self.known.prior), self.known.find_gain)
        texts = estimator.names, self.watch, self.threshold, known, calibration.left_out
        number = zlib.crc32(repr(texts).encode(), number)
        work = calibration.work
        scales = calibration.scale, work.scale
        arrays = [calibration.theta, *(part for one in scales for part in (one.inverse, one.energy, one.sigma))]
        warmth = calibration.warmth
        arrays += [] if warmth is None else [warmth.rate, np.array([warmth.mean])]
        arrays += [work.offset, work.limit, work.spread, np.array([work.size])]
        return zlib.crc32(b"".join(part.tobytes() for part in arrays), number)

    @cached_property
    def packers(self) -> tuple[ManyKernel, ManyKernel]:
        """Kernels that pack and run many states of the estimator and of the filter."""
        one, other = (
            kernel.many(1, fleet_layout(kernel, self.estimator.precision))
            for kernel in (self.estimator.kernel, self._filter.kernel)
        )
        return one, other

    def pack_state(self) -> AxisStates:
        """Return the state as arrays of one row."""
        kernels = self.estimator.kernel, self._filter.kernel
        estimator, filtered = (_pack_kernel(many, kernel) for many, kernel in zip(self.packers, kernels, strict=True))
        whole, real = self._inputs.numbers
        flagged, now = np.array([self._flagged], np.uint32), self._filter
        block, warmer = (now.sums.copy(), now.progress.copy()), np.array([[self._block_warmer, self._warmer]])
        sampled = Sampled(whole[None], real[None], flagged, warmer, estimator, filtered, *block)
        return AxisStates(sampled, self._own.copy_rows(), self._rest.copy_rows())

    def go_on(self, saved: AxisStates, axis: int) -> None:
        """Continue from the state of an axis, without a check of its numbers."""
        row, sampled = slice(axis, axis + 1), saved.sampled
        self._own.put(slice(0, 1), saved.watched.take_rows(row))
        self._rest.put(slice(0, 1), saved.disturbed.take_rows(row))
        if not np.array_equal(self._filter.theta, self._own.theta[0]):
            self._filter = ScoreFilter(self._front, self.reference, left_out=self.calibration.left_out)
        self._inputs.numbers, self._flagged = (sampled.whole[axis], sampled.real[axis]), int(sampled.flagged[axis])
        self._filter.sums[:], self._filter.progress[:] = sampled.sums[row], sampled.progress[row]
        kernels = self.estimator.kernel, self._filter.kernel
        for many, kernel, states in zip(self.packers, kernels, (sampled.estimator, sampled.filter), strict=True):
            many.hold(states[row])
            many.load(kernel, 0)
        block_warmer, self._warmer = sampled.warmer[axis].tolist()
        self._follow_temperature(block_warmer)

    def check_states(self, saved: AxisStates) -> AxisStates:
        """Return saved states of this configuration. Raises UsageError for numbers that no sample could have made."""
        watched, kernels = saved.watched, (saved.sampled.estimator, saved.sampled.filter)
        models = np.unique(np.concatenate([watched.theta, saved.disturbed.model]), axis=0)
        possible = saved.are_possible(self.scoring.size) and all(map(self.plausible, models))
        for many, states in zip(self.packers, kernels, strict=True):
            many.hold(states)
            possible = possible and many.plausible()
        if possible:
            self.derive(watched)
        if not possible or np.any(watched.waiting > watched.wait):
            raise UsageError(IMPLAUSIBLE)
        return saved

    def __reduce__(self) -> tuple[object, ...]:
        """Make copies and pickles from the configuration and the saved state."""
        return _resume_monitor, (self.estimator, self.calibration, self.watch, self.known, self.get_state())


def _resume_monitor(
    estimator: RecursiveEstimator, calibration: Calibration, watch: Watch, known: Known | None, state: bytes
) -> Monitor:
    monitor = Monitor(estimator, calibration, watch, known)
    monitor.set_state(state)
    return monitor


def _pack_kernel(many: ManyKernel, kernel: Kernel) -> NDArray[np.uint8]:
    """Return the state of a kernel as an array (1, bytes)."""
    many.hold(np.zeros((1, many.states.shape[1]), np.uint8))
    many.store(kernel, 0)
    return many.states


def new_outliers(status: int, before: int) -> list[str]:
    """Return the signals that are flagged in a status and were not flagged in the previous one.

    While the filters settle, nothing is an outlier: an input that is not finite is a lost sample, and the counts may
    have moved in the meantime.
    """
    if status & Status.SETTLING:
        return []
    return [signal for bit, signal in OUTLIERS.items() if status & bit and not before & bit]


def outliers(status: NDArray[np.uint32], flagged: int) -> tuple[list[tuple[int, str]], int]:
    """Return the samples of status (n,) at which a signal is newly flagged, with this signal, and the last status.

    `flagged` is the previous status.
    """
    found = list[tuple[int, str]]()
    if not status.size:
        return found, flagged
    if np.any(status & ANY_OUTLIER):
        for k, now in enumerate(status.tolist()):
            found += [(k, signal) for signal in new_outliers(now, flagged)]
            flagged = now
    return found, int(status[-1])
