"""The monitor of one axis without its recursion: samples, references, states and saved states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pmfid._estimate import Estimate
from pmfid.errors import UsageError
from pmfid.estimators.configuration import check_arrays, numbers
from pmfid.estimators.known import Seen
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS, WATCHING, Event, FleetRows, Settled, StateChange, Watch
from pmfid.monitor.rows import RowArrays
from pmfid.monitor.saved import read, write_states
from pmfid.status import Status
from pmfid.types import Floats


def check_further(name: str, values: ArrayLike | None, shape: tuple[int, ...]) -> Floats:
    """Return the further column of samples, with NaN for None. Raises UsageError for another shape."""
    checked = np.full(shape, np.nan) if values is None else np.asarray(numbers(name, values), np.float64)
    if checked.shape != shape:
        raise UsageError(f"{name} must have the shape {shape} of u, got {checked.shape}")
    return checked


class AxisMonitor(ABC):
    """Base class of monitors of one axis. `_own` has the state after each block or edge as arrays of one row."""

    estimator: Any
    watch: Watch
    threshold: float
    _own: Any

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the reported parameters."""
        return tuple(self.estimator.names)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the reported parameters."""
        return tuple(self.estimator.units)

    @property
    def state(self) -> str:
        """State of the monitor: STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS or SETTLING."""
        return STATES[self._own.state[0]]

    @property
    def statistic(self) -> float:
        """Statistic of the last comparison with the reference."""
        return float(self._own.statistic[0])

    @property
    def reference(self) -> Floats:
        """Parameters (p,) from which deviations are measured."""
        return np.array(self._own.theta[0])

    @property
    @abstractmethod
    def further(self) -> str:
        """Name of the further column of samples, "ages" or "temperature", or an empty text."""

    @property
    @abstractmethod
    def samples(self) -> int:
        """Number of samples so far, lost samples included."""

    @property
    @abstractmethod
    def _time(self) -> float:
        """Time of the sample to which the estimate belongs [s]."""

    @abstractmethod
    def step(self, u: float, counts: int, further: float) -> tuple[Estimate, list[Event]]:
        """Take one sample, and return the estimate and the events."""

    @abstractmethod
    def skip(self, samples: int) -> list[Event]:
        """Skip lost samples, and return the events."""

    def fill_gap(self, missing: int, u: float, counts: int) -> list[Event]:
        """Impute samples that were lost before the sample u, counts, and return the events. Samples that cannot be
        guessed are skipped.
        """
        return self.skip(missing)

    @abstractmethod
    def fresh(self) -> Any:
        """Return a new monitor with this configuration."""

    @abstractmethod
    def plausible(self, theta: Floats) -> bool:
        """Return whether a machine can have the parameters (p,)."""

    def apply_known(self, estimate: Estimate) -> Estimate | Seen:
        """Return an estimate combined with the prior information."""
        return estimate

    def _add_known(self, theta: Floats, std: Floats) -> tuple[Floats, Floats]:
        """Combine a reference (p,) and its standard deviations with the prior information. Both results are (q,)."""
        return theta, std

    def _remove_warmth(self, estimate: Estimate) -> Floats:
        """Return the estimated parameters (p,) at the conditions of the reference."""
        return np.array(estimate.theta)

    def run(self, u: ArrayLike, counts: ArrayLike, further: ArrayLike | None = None) -> FleetRows:
        """Take many samples u, counts (n,) and their `further` column (n,), as `step` in a loop.

        Returns the rows of a fleet of one axis. Raises UsageError if the arrays do not fit.
        """
        inputs, whole = check_arrays(u, counts)
        column = check_further(self.further, further, inputs.shape)
        rows = FleetRows.empty(1, inputs.size, len(self.names))
        for k, sample in enumerate(zip(inputs.tolist(), whole.tolist(), column.tolist(), strict=True)):
            estimate, events = self.step(*sample)
            shown = self.apply_known(estimate)
            rows.theta[0, k], rows.std[0, k] = shown.theta, shown.theta_std
            rows.innovation[0, k], rows.status[0, k] = estimate.innovation, estimate.status
            rows.state[0, k] = self._own.state[0]
            rows.events.extend((0, k, event) for event in events)
        return rows

    def _enter(self, state: str, reason: str) -> list[Event]:
        """Enter a state, and return the event if the state is a new one."""
        if state == self.state:
            return []
        self._own.state[0] = STATES.index(state)
        return [StateChange(self._time, state, reason)]

    def refer(self, theta: ArrayLike | None = None) -> list[Event]:
        """Make theta (p,) the reference, and return the events. None takes the present estimate.

        The events are the new reference, and a change of state if the axis was suspicious or settling. Raises
        UsageError, and changes nothing, if no estimate exists or if a machine cannot have the parameters.
        """
        estimate, before = self.estimator.estimate, self.reference
        unknown = estimate.status & (Status.STARTING | Status.FALLBACK) or not np.all(np.isfinite(estimate.theta_std))
        if theta is None and unknown:
            raise UsageError("no estimate exists yet that could become the reference: let the axis move first")
        wanted = np.array(self._remove_warmth(estimate) if theta is None else theta, np.float64)
        if wanted.shape != before.shape or not self.plausible(wanted):
            raise UsageError(
                f"no machine has the parameters {wanted.tolist()}; give valid values of {list(self.estimator.names)}"
            )
        std = np.array(estimate.theta_std) if theta is None else np.zeros(wanted.size)
        self._take_reference(wanted)
        settled = Settled(self._time, *self._add_known(wanted, std), self._add_known(before, std)[0])
        busy = self.state in (SUSPICIOUS, SETTLING)
        return [settled, *(self._enter(WATCHING, "a new reference was given") if busy else [])]

    @abstractmethod
    def _take_reference(self, theta: Floats) -> None:
        """Measure deviations from theta (p,) from now on."""

    @property
    @abstractmethod
    def configuration_number(self) -> int:
        """Checksum of the configuration."""

    @abstractmethod
    def pack_state(self) -> RowArrays:
        """Return the state as arrays of one row."""

    @abstractmethod
    def go_on(self, saved: Any, axis: int) -> None:
        """Continue from the state of an axis, without a check of its numbers."""

    @abstractmethod
    def check_states(self, saved: Any) -> Any:
        """Return saved states of this configuration. Raises UsageError for numbers that no sample could have made."""

    def get_state(self) -> bytes:
        """Return the state with a version and checksums.

        `set_state` of a monitor with the same configuration continues from this state.
        """
        return write_states(self.pack_state(), self.configuration_number)

    def set_state(self, state: bytes) -> None:
        """Continue from a saved state.

        Raises UsageError, and changes nothing, for a state of another configuration, a damaged state, and numbers that
        no sample could have made.
        """
        saved = self.check_states(read(state, self.pack_state(), self.configuration_number))
        if saved.axes != 1:
            raise UsageError(f"these bytes contain the states of {saved.axes} axes, and a monitor has one axis")
        self.go_on(saved, 0)
