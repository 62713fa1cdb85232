"""Files in which every signal has a clock of its own: signals on one common clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

#: The column of stamps [s].
TIME: Final = "time"
#: Largest difference of stamps within one cycle of a task, as a part of the cycle.
CYCLE = 0.5


@dataclass(frozen=True, eq=False)
class Signal:
    """time: stamps (n,) [s]; values (n,) at these."""

    time: Floats
    values: NDArray[np.generic]


class ClockedSignals(Mapping[str, object]):
    """Signals by name, on the clock of one of them: `TIME` has its stamps. Another with one value in each of its cycles
    is taken cycle by cycle, and any other holds its last value."""

    def __init__(self, signals: Mapping[str, Signal], base: str = "", others: tuple[str, ...] = ()) -> None:
        """base: the signal with the clock, by default the longest; others: signals that must have begun."""
        self._signals = signals
        usual = max(signals, key=lambda name: signals[name].time.size, default="")
        stamps = signals[base if base in signals else usual].time if signals else np.empty(0)
        starts = [signals[name].time[0] for name in others if name in signals and signals[name].time.size]
        self._from = int(np.searchsorted(stamps, max(starts, default=-np.inf) - CYCLE * _period(stamps)))
        self._stamps, self._held = stamps, dict[str, None]()

    def align(self, base: str, others: tuple[str, ...]) -> ClockedSignals:
        """The signals on the clock of `base`, from the first stamp at which the others have begun."""
        return ClockedSignals(self._signals, base, others)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the requested columns that hold their last value."""
        return tuple(
            f"{name} has stamps of its own: its last value is taken at those of the output" for name in self._held
        )

    def __getitem__(self, name: str) -> object:
        if name == TIME and name not in self._signals:
            return self._stamps[self._from :]
        return self._sample(name, self._signals[name])[self._from :]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((TIME, *self._signals)))

    def __len__(self) -> int:
        return len(set(self._signals) | {TIME})

    def _sample(self, name: str, signal: Signal) -> NDArray[np.generic]:
        """The values of a signal at the stamps."""
        stamps, time = self._stamps, signal.time
        if time.size == stamps.size and np.all(np.abs(time - stamps) <= CYCLE * _period(stamps)):
            return signal.values
        self._held[name] = None
        last = np.searchsorted(time, stamps, side="right") - 1
        if not time.size:
            return np.full(stamps.size, np.nan)
        return np.where(last < 0, np.nan, np.asarray(signal.values, np.float64)[np.maximum(last, 0)])


def _period(stamps: Floats) -> float:
    return float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
