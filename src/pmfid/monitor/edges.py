"""A monitor of one axis whose encoder gives the instants of its edges."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pmfid._estimate import Estimate
from pmfid.errors import UsageError
from pmfid.estimators.redge import REdge
from pmfid.monitor.base import AxisMonitor
from pmfid.monitor.cause import Cause, ChangeEvidence, explain
from pmfid.monitor.events import (
    CANNOT_TELL,
    SETTLING,
    STARTING,
    STATES,
    SUSPICIOUS,
    WATCHING,
    Alarm,
    Event,
    Settled,
    Watch,
)
from pmfid.monitor.rows import MOST, RowArrays, rows_of
from pmfid.monitor.saved import IMPLAUSIBLE
from pmfid.monitor.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Flags, Floats


@dataclass
class EdgeStates(RowArrays):
    """The states of some axes with edge times.

    `theta` (k, p) is the reference, `before` the one before, and `base` the last sound estimate. `armed` is true if a
    suspicion is possible. `silent` is the number of samples since the last edge, `since` the number since the last
    suspicion or alarm, and `counts` the last counts. `referred` is the number of samples at the reference. `cause`
    identifies parameter and direction of the last alarm, and `goes_on` is true while its slow change goes on. `rate` is
    the relative change per hour of a slow change, or 0. `recursion` (k, bytes) is the state of the estimator.
    """

    theta: Floats = field(metadata=rows_of("p"))
    before: Floats = field(metadata=rows_of("p"))
    base: Floats = field(metadata=rows_of("p"))
    state: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    armed: Flags = field(metadata=rows_of(kind=np.bool_))
    samples: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    silent: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    since: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    counts: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    referred: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    cause: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    goes_on: Flags = field(metadata=rows_of(kind=np.bool_))
    statistic: Floats = field(metadata=rows_of())
    rate: Floats = field(metadata=rows_of())
    recursion: NDArray[np.uint8] = field(metadata=rows_of("bytes", kind=np.uint8))

    def are_possible(self) -> bool:
        """Return whether samples can have made these numbers, except the parameters and those of the recursion."""
        counted = (self.samples, self.silent, self.since, self.referred, self.cause)
        fine = np.all(np.isfinite(self.statistic) & np.isfinite(self.rate) & (self.state < len(STATES)))
        return bool(fine and all(np.all((number >= 0) & (number <= MOST)) for number in counted))


@dataclass(repr=False)
class EdgeMonitor(AxisMonitor):
    """A monitor that compares the estimate of `REdge` with a reference.

    A parameter has changed if its deviation exceeds the tolerance by more standard errors than chance makes in the mean
    time between false alarms. Estimates that are two memories apart count as independent, and errors as normal.
    `REdge` opens its memory by itself after a change. The new value then becomes the reference.

    Parameters
    ----------
    estimator : REdge
        Estimator with a memory, before its first sample.
    normal : array (p,)
        Values in normal work of mass, viscous and Coulomb friction, and of the offset if the model has one.
    watch : Watch
        Mean time between false alarms, and tolerance. The detector has no effect.

    Raises
    ------
    UsageError
        The estimator never forgets, or the normal values are those of other parameters.

    Examples
    --------
    A cart is loaded after 10 s.

    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, REdge
    >>> from pmfid.monitor import Alarm, EdgeMonitor
    >>> from pmfid.simulation import CART, capture_edges, change_parameters, prbs, simulate_drive
    >>> u = prbs(2000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> motion = simulate_drive(change_parameters(CART, at=10.0, mass=1.44), np.repeat(u, 10), 1e-3)
    >>> counts, ages = capture_edges(motion, 0.0015, every=10, tick=1e-6)
    >>> estimator = REdge(Drive(CART.input_gain), Encoder(0.0015), 0.01, lines=64, tick=1e-6, memory=10.0)
    >>> monitor = EdgeMonitor(estimator, np.array([1.07, 12.8, 0.8]))
    >>> samples = zip(u.tolist(), counts.tolist(), ages.tolist(), strict=True)
    >>> events = [event for sample in samples for event in monitor.step(*sample)[1]]
    >>> [event.parameter for event in events if isinstance(event, Alarm)]
    ['mass']
    """

    estimator: REdge
    normal: Floats
    watch: Watch = field(default_factory=Watch)

    def __post_init__(self) -> None:
        normal = self.normal = np.array(self.normal, np.float64)
        if self.estimator.memory is None:
            raise UsageError("the estimator of a monitor must forget: give it a memory in s")
        if normal.shape != (len(self.names),) or not self.plausible(normal):
            raise UsageError(
                f"normal must contain values of {list(self.names)}, all positive except an offset, got "
                f"{normal.tolist()}"
            )
        self.threshold = self._quantile()
        state = self.estimator.kernel.raw_state()
        self._own = EdgeStates.empty(1, p=normal.size, bytes=len(state))
        self._own.theta[:] = self._own.before[:] = self._own.base[:] = normal

    def _quantile(self) -> float:
        """Return the standard errors that chance exceeds once in the mean time between false alarms."""
        from scipy.stats import norm

        tests = 3600 * self.watch.mtbf_hours / (2 * float(self.estimator.memory or 1.0)) * 2 * len(self.names)
        return float(norm.isf(1 / max(tests, TUNING.edge_tests)))

    @property
    def further(self) -> str:
        return "ages"

    @property
    def samples(self) -> int:
        return int(self._own.samples[0])

    @property
    def _signed(self) -> Flags:
        """Whether each parameter (p,) may be zero or negative, as the offset may."""
        return np.array([name == "offset" for name in self.names])

    def plausible(self, theta: Floats) -> bool:
        """Return whether parameters (..., p) are finite, and positive except for the offset."""
        return bool(np.all(np.isfinite(theta) & ((theta > 0) | self._signed)))

    def _sizes_of(self, values: Floats) -> Floats:
        """Return what changes of parameters (..., p) are relative to: themselves, and at least Coulomb friction for the
        offset, which may be zero."""
        sizes = np.abs(values)
        friction = sizes[..., self.names.index("coulomb_friction"), None]
        return np.where(self._signed, np.maximum(sizes, friction), sizes)

    def _bound(self, values: Floats) -> Floats:
        """Return parameters (p,) that are positive except for the offset."""
        return np.where(self._signed, values, np.maximum(values, TUNING.edge_least * self.reference))

    @property
    def _time(self) -> float:
        return (self.samples - 1) * self.estimator.dt

    def step(self, u: float, counts: int, age: float | None = None) -> tuple[Estimate, list[Event]]:
        """Take one sample as `REdge.step` does, and return the estimate and the events."""
        if not math.isfinite(u):
            return self.estimator.estimate, self.skip(1)
        estimate, own = self.estimator.step(u, counts, age), self._own
        own.samples[0] += 1
        moved = counts != own.counts[0]
        own.silent[0], own.counts[0] = 0 if moved else own.silent[0] + 1, counts
        own.since[0] += 1
        return estimate, self._judge(estimate) if moved or own.silent[0] == self.patience else []

    def skip(self, samples: int) -> list[Event]:
        """Skip lost samples, and return the events. The recursion begins again at the last sound estimate."""
        self.estimator.reset()
        self._own.samples[0] += samples
        if self.state == STARTING:
            return []
        self._expect_base()
        return self._enter(CANNOT_TELL, "samples are missing")

    def _expect_base(self) -> None:
        """Let the estimator begin again at the last sound estimate."""
        self.estimator.expect(self._bound(self._own.base[0]))
        self._own.armed[0] = False

    @property
    def patience(self) -> int:
        """Samples without an edge after which the axis rests."""
        return max(1, round(TUNING.silent_time / self.estimator.dt))

    def _judge(self, estimate: Estimate) -> list[Event]:
        """Return the events of an estimate after an edge or a long rest."""
        own = self._own
        if self.state in (SUSPICIOUS, SETTLING):
            weigh = self._weigh if self.state == SUSPICIOUS else self._settle
            return [] if own.silent[0] or estimate.status & Status.STARTING else weigh(estimate)
        if estimate.status & Status.STARTING:
            waits = self.state == STARTING or (self.state == CANNOT_TELL and not own.armed[0])  # after lost samples
            return [] if waits else self._suspect()
        if own.silent[0]:
            return self._enter(CANNOT_TELL, "standstill")
        distorted = bool(estimate.status & Status.DISTORTED)
        if distorted and own.armed[0]:
            return self._suspect()
        doubtful = self._weigh_deviations(np.array(estimate.theta), np.array(estimate.theta_std), distorted)
        # If an estimate that was certain becomes both doubtful and distorted, the recursion has raised an alarm.
        alarmed = doubtful and distorted and self.state == WATCHING
        if doubtful and not alarmed:
            return self._enter(CANNOT_TELL, "poor excitation")
        if alarmed or self.statistic > self.threshold:
            return self._suspect()
        if not distorted:
            own.base[0], own.armed[0] = np.array(estimate.theta), True
        return self._enter(WATCHING, "")

    def _weigh_deviations(self, theta: Floats, std: Floats, distorted: bool) -> bool:
        """Find the statistic of an estimate (p,), and return whether it is too uncertain to tell a change.

        If `distorted`, the standard errors are wider. The largest deviation beyond the tolerance is the statistic.
        """
        sizes = self._sizes_of(self.reference)
        error = std * (TUNING.edge_doubt if distorted else 1.0) / sizes
        self._own.statistic[0] = np.max((np.abs(theta - self.reference) / sizes - self.watch.tolerance) / error)
        return bool(self.threshold * error.max() > TUNING.edge_known)

    def _suspect(self) -> list[Event]:
        """Look for a change from the last sound estimate on."""
        self._expect_base()
        self._own.since[0] = 0
        return self._enter(SUSPICIOUS, "a deviation was found, and its cause is not clear yet")

    def _weigh(self, estimate: Estimate) -> list[Event]:
        """Return an alarm if the changes that explain the estimate are beyond the tolerance and chance.

        A change that is certainly within the tolerance ends the suspicion without an alarm. Until the recursion moves
        its reference, the estimate has errors of second order, which can hide the cause. A slow change shows only
        against the reference, because each sound estimate has a part of it.
        """
        own = self._own
        evidence = ChangeEvidence(np.array(estimate.theta), np.array(estimate.theta_cov))
        moved, tolerance = evidence.theta - own.base[0], self.watch.tolerance
        bend = min(float(np.max(np.abs(moved) / self._sizes_of(own.base[0]))), TUNING.edge_bend)
        doubtful = replace(evidence, covariance=evidence.covariance + np.diag((bend * moved) ** 2))
        cause, sure = (explain(one, own.base[0], self.estimator.equation, tolerance) for one in (doubtful, evidence))
        sizes = self._sizes_of(self.reference)
        relative = (evidence.theta - self.reference) / sizes
        error = self.threshold * np.array(estimate.theta_std) / sizes
        late = own.since[0] >= TUNING.edge_confirmed * self.patience
        own.statistic[0] = max((abs(one.relative) - tolerance) / one.relative_std for one in sure.changes)
        if self.statistic > self.threshold and (late or not cause.near):
            return self._alarm(cause, slow=cause.size < TUNING.axis_pace * float(np.max(np.abs(relative))))
        if late and np.any(np.abs(relative) - error > tolerance):
            slow = explain(evidence, self.reference, self.estimator.equation, tolerance)
            own.statistic[0] = max((abs(one.relative) - tolerance) / one.relative_std for one in slow.changes)
            return self._alarm(slow, slow=True)
        if np.all(np.abs(relative) + error < tolerance) or (late and error.max() < TUNING.edge_known):
            own.base[0] = evidence.theta
            return self._enter(WATCHING, "the deviation is within the tolerance")
        return []

    def _alarm(self, cause: Cause, slow: bool = False) -> list[Event]:
        own = self._own
        begun, own.before[0] = self._time - float(own.since[0]) * self.estimator.dt, own.theta[0]
        # the estimate may still have errors of second order
        changes = tuple(replace(one, std=math.hypot(one.std, one.relative * one.change)) for one in cause.changes)
        numbers = self.statistic, self.threshold
        alarm = Alarm(self._time, begun, changes, *numbers, cause.others, self.watch.tolerance)
        own.since[0] = 0
        number = crc32(f"{alarm.parameter} {alarm.change > 0}".encode())
        rate = 3600 * alarm.relative / ((self.samples - own.referred[0]) * self.estimator.dt)
        # After a pause, the mean rate is lower. A step is larger than the rate explains.
        pace = rate / own.rate[0] if number == own.cause[0] and own.rate[0] else 0.0
        own.goes_on[0] = pace > TUNING.axis_pace and (slow or pace < 1 / TUNING.axis_pace)
        own.cause[0], own.rate[0] = number, rate if slow or own.goes_on[0] else 0.0
        return [
            *([] if own.goes_on[0] else [alarm]),
            *self._enter(SETTLING, f"measuring the new {' and '.join(cause.names)}"),
        ]

    def _settle(self, estimate: Estimate) -> list[Event]:
        """Make the estimate the reference, once it is sure."""
        own = self._own
        theta, std = np.array(estimate.theta), np.array(estimate.theta_std)
        sure = bool(np.all(self.threshold * std < 0.5 * self.watch.tolerance * self._sizes_of(theta)))
        if own.since[0] < self.patience or not (sure or own.since[0] >= TUNING.edge_settled * self.patience):
            return []
        self._take_reference(self._bound(theta))
        rate, before = float(own.rate[0]) if own.goes_on[0] else None, own.before[0].copy()
        evidence = ChangeEvidence(theta, np.array(estimate.theta_cov))
        cause = explain(evidence, before, self.estimator.equation, self.watch.tolerance)
        return [
            Settled(self._time, theta, std, before, None, rate, cause.changes, cause.others),
            *self._enter(WATCHING, ""),
        ]

    def _take_reference(self, theta: Floats) -> None:
        self._own.theta[0] = self._own.base[0] = theta
        self._own.referred[0] = self.samples

    def fresh(self) -> EdgeMonitor:
        """Return a new monitor with this configuration."""
        return EdgeMonitor(replace(self.estimator), self.normal, copy(self.watch))

    @property
    def configuration_number(self) -> int:
        """Checksum of the configuration."""
        return crc32(repr((self.estimator, self.watch)).encode())

    def pack_state(self) -> EdgeStates:
        """Return the state as arrays of one row."""
        states: EdgeStates = self._own.copy_rows()
        states.recursion[0] = np.frombuffer(self.estimator.kernel.raw_state(), np.uint8)
        return states

    def go_on(self, saved: EdgeStates, axis: int) -> None:
        """Continue from the state of an axis, whose numbers are possible."""
        self._own.put(slice(0, 1), saved.take_rows(slice(axis, axis + 1)))
        self.estimator.kernel.set_raw_state(saved.recursion[axis].tobytes())

    def check_states(self, saved: EdgeStates) -> EdgeStates:
        """Return saved states of this configuration. Raises UsageError for numbers that no sample could have made."""
        kernel = self.estimator.kernel
        values = np.stack([saved.theta, saved.before, saved.base])
        before, possible = kernel.raw_state(), saved.are_possible() and self.plausible(values)
        try:
            for row in saved.recursion if possible else ():
                kernel.set_raw_state(row.tobytes())
        except ValueError:
            possible = False
        kernel.set_raw_state(before)
        if not possible:
            raise UsageError(IMPLAUSIBLE)
        return saved
