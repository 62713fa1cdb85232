"""A monitor of one axis whose encoder gives the instants of its edges."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from typing import ClassVar
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid._estimate import Estimate
from pmfid.errors import UsageError
from pmfid.estimators.redge import REdge
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
    FleetRows,
    Settled,
    StateChange,
    Watch,
)
from pmfid.monitor.rows import RowArrays
from pmfid.monitor.saved import IMPLAUSIBLE, MOST, read, write_states
from pmfid.monitor.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Flags, Floats


@dataclass
class EdgeStates(RowArrays):
    """The states of some axes with edge times.

    `state` (k,) is the number of the state, and `armed` (k,) is true if a suspicion is possible. `whole` (k, 7) has the
    samples so far, the samples since the last edge and since the last suspicion or alarm, the last counts, the samples
    at the reference, parameter and direction of the last alarm as a number, and 1 while its slow change goes on.
    `statistic` is (k,). `rate` (k,) is the relative change per hour of a slow change, or 0. `values` (k, 3, p) has the
    reference, the one before, and the last sound estimate. `recursion` (k, bytes) is the state of the estimator.
    """

    state: NDArray[np.uint8]
    armed: Flags
    whole: NDArray[np.int64]
    statistic: Floats
    rate: Floats
    values: Floats
    recursion: NDArray[np.uint8]

    @property
    def samples(self) -> NDArray[np.int64]:
        return self.whole[:, SAMPLES]

    def are_possible(self) -> bool:
        """Return whether samples can have made these numbers, except the parameters and those of the recursion."""
        fine = np.all(np.isfinite(self.statistic) & np.isfinite(self.rate))
        counted = np.delete(self.whole, COUNTS, axis=1)
        return bool(fine and np.all(self.state < len(STATES)) and np.all((counted >= 0) & (counted <= MOST)))


#: Columns of `EdgeStates.whole`.
SAMPLES, SILENT, SINCE, COUNTS, REFERRED, CAUSE, GOES_ON = range(7)
#: Rows of `EdgeStates.values`.
REFERENCE, BEFORE, BASE = range(3)


@dataclass
class EdgeMonitor:
    """A monitor that compares the estimate of `REdge` with a reference.

    A parameter has changed if its deviation exceeds the tolerance by more standard errors than chance makes in the mean
    time between false alarms. Estimates that are two memories apart count as independent, and errors as normal.
    `REdge` opens its memory by itself after a change. The new value then becomes the reference.

    Parameters
    ----------
    estimator : REdge
        Estimator with a memory, before its first sample.
    reference : array (p,)
        Normal values of mass, viscous and Coulomb friction, and of the offset if the model has one.
    watch : Watch
        Mean time between false alarms, and tolerance. The detector has no effect.

    Raises
    ------
    UsageError
        The estimator never forgets, or the reference has other parameters.

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
    reference: Floats
    watch: Watch = field(default_factory=Watch)
    longest: ClassVar[int] = 0  # missing samples that can be guessed

    def __post_init__(self) -> None:
        self.reference = np.array(self.reference, np.float64)
        if self.estimator.memory is None:
            raise UsageError("the estimator of a monitor must forget: give it a memory in s")
        if self.reference.shape != (len(self.names),) or not self._are_parameters(self.reference):
            raise UsageError(
                f"reference must contain values of {list(self.names)}, all positive except an offset, got "
                f"{self.reference.tolist()}"
            )
        self.threshold = self._quantile()
        self.state, self.samples, self.statistic = STARTING, 0, 0.0
        self._before = self._base = self.reference
        self._silent, self._since, self._counts, self._armed = 0, 0, 0, False
        self._referred, self._cause, self._goes_on, self._rate = 0, 0, False, 0.0

    def _quantile(self) -> float:
        """Return the standard errors that chance exceeds once in the mean time between false alarms."""
        from scipy.stats import norm

        tests = 3600 * self.watch.mtbf_hours / (2 * float(self.estimator.memory or 1.0)) * 2 * len(self.names)
        return float(norm.isf(1 / max(tests, TUNING.edge_tests)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.estimator.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return self.estimator.units

    @property
    def _signed(self) -> Flags:
        """Whether each parameter (p,) may be zero or negative, as the offset may."""
        return np.array([name == "offset" for name in self.names])

    def _are_parameters(self, values: Floats) -> bool:
        """Return whether values (..., p) are finite, and positive except for the offset."""
        return bool(np.all(np.isfinite(values) & ((values > 0) | self._signed)))

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
        estimate = self.estimator.step(u, counts, age)
        self.samples += 1
        moved = counts != self._counts
        self._silent, self._counts = 0 if moved else self._silent + 1, counts
        self._since += 1
        return estimate, self._judge(estimate) if moved or self._silent == self.patience else []

    def skip(self, samples: int) -> list[Event]:
        """Skip lost samples, and return the events. The recursion begins again at the last sound estimate."""
        self.estimator.reset()
        self.samples += samples
        if self.state == STARTING:
            return []
        self._expect_base()
        return self._enter(CANNOT_TELL, "samples are missing")

    def _expect_base(self) -> None:
        """Let the estimator begin again at the last sound estimate."""
        self.estimator.expect(self._bound(self._base))
        self._armed = False

    @property
    def patience(self) -> int:
        """Samples without an edge after which the axis rests."""
        return max(1, round(TUNING.silent_time / self.estimator.dt))

    def _judge(self, estimate: Estimate) -> list[Event]:
        """Return the events of an estimate after an edge or a long rest."""
        if self.state in (SUSPICIOUS, SETTLING):
            weigh = self._weigh if self.state == SUSPICIOUS else self._settle
            return [] if self._silent or estimate.status & Status.STARTING else weigh(estimate)
        if estimate.status & Status.STARTING:
            waits = self.state == STARTING or (self.state == CANNOT_TELL and not self._armed)  # after lost samples
            return [] if waits else self._suspect()
        if self._silent:
            return self._enter(CANNOT_TELL, "standstill")
        distorted = bool(estimate.status & Status.DISTORTED)
        if distorted and self._armed:
            return self._suspect()
        doubtful = self._weigh_deviations(np.array(estimate.theta), np.array(estimate.theta_std), distorted)
        # If an estimate that was certain becomes both doubtful and distorted, the recursion has raised an alarm.
        alarmed = doubtful and distorted and self.state == WATCHING
        if doubtful and not alarmed:
            return self._enter(CANNOT_TELL, "poor excitation")
        if alarmed or self.statistic > self.threshold:
            return self._suspect()
        if not distorted:
            self._base, self._armed = np.array(estimate.theta), True
        return self._enter(WATCHING, "")

    def _weigh_deviations(self, theta: Floats, std: Floats, distorted: bool) -> bool:
        """Find the statistic of an estimate (p,), and return whether it is too uncertain to tell a change.

        If `distorted`, the standard errors are wider. The largest deviation beyond the tolerance is the statistic.
        """
        sizes = self._sizes_of(self.reference)
        error = std * (TUNING.edge_doubt if distorted else 1.0) / sizes
        self.statistic = float(np.max((np.abs(theta - self.reference) / sizes - self.watch.tolerance) / error))
        return bool(self.threshold * error.max() > TUNING.edge_known)

    def _suspect(self) -> list[Event]:
        """Look for a change from the last sound estimate on."""
        self._expect_base()
        self._since = 0
        return self._enter(SUSPICIOUS, "a deviation was found, and its cause is not clear yet")

    def _weigh(self, estimate: Estimate) -> list[Event]:
        """Return an alarm if the changes that explain the estimate are beyond the tolerance and chance.

        A change that is certainly within the tolerance ends the suspicion without an alarm. Until the recursion moves
        its reference, the estimate has errors of second order, which can hide the cause. A slow change shows only
        against the reference, because each sound estimate has a part of it.
        """
        evidence = ChangeEvidence(np.array(estimate.theta), np.array(estimate.theta_cov))
        moved, tolerance = evidence.theta - self._base, self.watch.tolerance
        bend = min(float(np.max(np.abs(moved) / self._sizes_of(self._base))), TUNING.edge_bend)
        doubtful = replace(evidence, covariance=evidence.covariance + np.diag((bend * moved) ** 2))
        cause, sure = (explain(one, self._base, self.estimator.equation, tolerance) for one in (doubtful, evidence))
        sizes = self._sizes_of(self.reference)
        relative = (evidence.theta - self.reference) / sizes
        error = self.threshold * np.array(estimate.theta_std) / sizes
        late = self._since >= TUNING.edge_confirmed * self.patience
        self.statistic = max((abs(one.relative) - tolerance) / one.relative_std for one in sure.changes)
        if self.statistic > self.threshold and (late or not cause.near):
            return self._alarm(cause, slow=cause.size < TUNING.edge_slow * float(np.max(np.abs(relative))))
        if late and np.any(np.abs(relative) - error > tolerance):
            slow = explain(evidence, self.reference, self.estimator.equation, tolerance)
            self.statistic = max((abs(one.relative) - tolerance) / one.relative_std for one in slow.changes)
            return self._alarm(slow, slow=True)
        if np.all(np.abs(relative) + error < tolerance) or (late and error.max() < TUNING.edge_known):
            self._base = evidence.theta
            return self._enter(WATCHING, "the deviation is within the tolerance")
        return []

    def _alarm(self, cause: Cause, slow: bool = False) -> list[Event]:
        begun, self._before = self._time - self._since * self.estimator.dt, self.reference.copy()
        # the estimate may still have errors of second order
        changes = tuple(replace(one, std=math.hypot(one.std, one.relative * one.change)) for one in cause.changes)
        numbers = self.statistic, self.threshold
        alarm = Alarm(self._time, begun, changes, *numbers, cause.others, self.watch.tolerance)
        self._since = 0
        number = crc32(f"{alarm.parameter} {alarm.change > 0}".encode())
        rate = 3600 * alarm.relative / ((self.samples - self._referred) * self.estimator.dt)
        # After a pause, the mean rate is lower. A step is larger than the rate explains.
        pace = rate / self._rate if number == self._cause and self._rate else 0.0
        self._goes_on = pace > TUNING.edge_slow and (slow or pace < 1 / TUNING.edge_slow)
        self._cause, self._rate = number, rate if slow or self._goes_on else 0.0
        return [
            *([] if self._goes_on else [alarm]),
            *self._enter(SETTLING, f"measuring the new {' and '.join(cause.names)}"),
        ]

    def _settle(self, estimate: Estimate) -> list[Event]:
        """Make the estimate the reference, once it is sure."""
        theta, std = np.array(estimate.theta), np.array(estimate.theta_std)
        sure = bool(np.all(self.threshold * std < 0.5 * self.watch.tolerance * self._sizes_of(theta)))
        if self._since < self.patience or not (sure or self._since >= TUNING.edge_settled * self.patience):
            return []
        self.reference, self._referred = self._bound(theta), self.samples
        self._base = self.reference
        rate = self._rate if self._goes_on else None
        return [Settled(self._time, theta, std, self._before, rate=rate), *self._enter(WATCHING, "")]

    def _enter(self, state: str, reason: str) -> list[Event]:
        if state == self.state:
            return []
        self.state = state
        return [StateChange(self._time, state, reason)]

    def refer(self, theta: ArrayLike | None = None) -> list[Event]:
        """Make theta (p,) the reference, and return the events. None takes the present estimate.

        The events are the new reference, and a change of state if the axis was suspicious or settling. Raises
        UsageError, and changes nothing, if no estimate exists or if a machine cannot have the parameters.
        """
        estimate = self.estimator.estimate
        if theta is None and estimate.status & Status.STARTING:
            raise UsageError("no estimate exists yet that could become the reference: let the axis move first")
        wanted = np.array(estimate.theta if theta is None else theta, np.float64)
        if wanted.shape != self.reference.shape or not self._are_parameters(wanted):
            raise UsageError(
                f"no machine has the parameters {wanted.tolist()}; give valid values of {list(self.names)}"
            )
        std = np.array(estimate.theta_std) if theta is None else np.zeros(wanted.size)
        before, self.reference, self._base = self.reference, wanted, wanted
        self._referred = self.samples
        busy = self.state in (SUSPICIOUS, SETTLING)
        changes = self._enter(WATCHING, "a new reference was given") if busy else []
        return [Settled(self._time, wanted, std, before), *changes]

    def run(self, u: ArrayLike, counts: ArrayLike, ages: ArrayLike) -> FleetRows:
        """Take many samples u, counts, ages (n,), and return the rows of a fleet of one axis, as `step` in a loop."""
        samples = list(zip(*(np.asarray(array).tolist() for array in (u, counts, ages)), strict=True))
        rows = FleetRows.empty(1, len(samples), len(self.names))
        for k, sample in enumerate(samples):
            estimate, events = self.step(*sample)
            rows.theta[0, k], rows.std[0, k] = estimate.theta, estimate.theta_std
            rows.innovation[0, k], rows.status[0, k] = estimate.innovation, estimate.status
            rows.state[0, k] = STATES.index(self.state)
            rows.events.extend((0, k, event) for event in events)
        return rows

    def fresh(self) -> EdgeMonitor:
        """Return a new monitor with this configuration."""
        return EdgeMonitor(replace(self.estimator), self.reference, copy(self.watch))

    @property
    def configuration_number(self) -> int:
        """Checksum of the configuration."""
        return crc32(repr((self.estimator, self.watch)).encode())

    def pack_state(self) -> EdgeStates:
        """Return the state as arrays of one row."""
        numbers = self.samples, self._silent, self._since, self._counts
        return EdgeStates(
            np.array([STATES.index(self.state)], np.uint8),
            np.array([self._armed]),
            np.array([[*numbers, self._referred, self._cause, self._goes_on]], np.int64),
            np.array([self.statistic]),
            np.array([self._rate]),
            np.stack([self.reference, self._before, self._base])[None],
            np.frombuffer(self.estimator.kernel.raw_state(), np.uint8)[None],
        )

    def go_on(self, saved: EdgeStates, axis: int) -> None:
        """Continue from the state of an axis, whose numbers are possible."""
        self.estimator.kernel.set_raw_state(saved.recursion[axis].tobytes())
        self.state, self._armed = STATES[saved.state[axis]], bool(saved.armed[axis])
        self.samples, self._silent, self._since, self._counts, *rest = saved.whole[axis].tolist()
        self._referred, self._cause, self._goes_on = rest[0], rest[1], bool(rest[2])
        self.statistic, self._rate = float(saved.statistic[axis]), float(saved.rate[axis])
        self.reference, self._before, self._base = saved.values[axis].copy()

    def check_states(self, saved: EdgeStates) -> EdgeStates:
        """Return saved states of this configuration. Raises UsageError for numbers that no sample could have made."""
        kernel = self.estimator.kernel
        before, possible = kernel.raw_state(), saved.are_possible() and self._are_parameters(saved.values)
        try:
            for row in saved.recursion if possible else ():
                kernel.set_raw_state(row.tobytes())
        except ValueError:
            possible = False
        kernel.set_raw_state(before)
        if not possible:
            raise UsageError(IMPLAUSIBLE)
        return saved

    def get_state(self) -> bytes:
        """Return the state with a version and checksums, for `set_state` of a monitor with the same configuration."""
        return write_states(self.pack_state(), self.configuration_number)

    def set_state(self, state: bytes) -> None:
        """Continue from a saved state. Raises UsageError, and changes nothing, for other bytes."""
        found = self.check_states(read(state, self.pack_state(), self.configuration_number))
        if found.axes != 1:
            raise UsageError(f"these bytes contain the states of {found.axes} axes, and a monitor has one axis")
        self.go_on(found, 0)
