"""Whether stamps come with the sample period that a monitor was calibrated for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from pmfid.errors import UsageError

#: Steps from line to line that are judged together, and how much another period they must show.
STEPS, COARSE = 25, 0.05
#: Such groups in a row, before and after one of the right period: a logger that was late writes many lines at once.
FIRST, LATER = 1, 3
#: Steps below are a line that is doubled, no step [sample periods].
DOUBLED = 0.02
#: A group tells a period if so large a part of its steps is so near their mean.
REGULAR, CLOSE = 0.8, 0.25
#: Samples after which the mean period must be right to so much.
LONG, FINE = 500, 0.005

#: Where something is, as an object for JSON.
Saved = dict[str, Any]


@dataclass
class Period:
    """dt: what is expected [s]. Every method raises UsageError once the period is known to be another."""

    dt: float
    _steps: list[float] = field(default_factory=list, init=False)
    _last: float = field(default=math.nan, init=False)
    _wrong: int = field(default=0, init=False)
    _patience: int = field(default=FIRST, init=False)
    _start: float = field(default=math.nan, init=False)
    _count: int = field(default=0, init=False)
    _checked: bool = field(default=False, init=False)

    def save_state(self) -> Saved:
        """Where it is, for JSON that knows NaN."""
        return {
            "steps": list(self._steps),
            "last": self._last,
            "wrong": self._wrong,
            "patience": self._patience,
            "start": self._start,
            "count": self._count,
            "checked": self._checked,
        }

    def restore(self, saved: Saved) -> None:
        """Goes on from where another one was. Raises KeyError, TypeError or ValueError for what none has saved."""
        self._steps, self._last = [float(step) for step in saved["steps"]], float(saved["last"])
        self._wrong, self._patience = int(saved["wrong"]), int(saved["patience"])
        self._start, self._count, self._checked = float(saved["start"]), int(saved["count"]), bool(saved["checked"])

    def line(self, time: float) -> None:
        """A stamp [s], whatever it is worth."""
        step, self._last = (time - self._last) / self.dt, time
        if abs(step) > DOUBLED:
            self._steps.append(step)
        if len(self._steps) == STEPS:
            steps, self._steps = np.array(self._steps), []
            self._judge(steps)

    def sample(self, time: float) -> None:
        """The stamp [s] of a line that is a sample."""
        if math.isnan(self._start):
            self._start, self._count = time, 0
            return
        self._count += 1
        if self._count >= LONG and not self._checked:
            self._checked = True
            mean = (time - self._start) / (self._count * self.dt)
            if abs(mean - 1) > FINE:
                self._refuse(mean)

    def slots(self, samples: int) -> None:
        """Samples without a line."""
        self._count += samples

    def restart(self) -> None:
        """The clock was set."""
        self._start, self._checked, self._patience = math.nan, False, FIRST

    def _judge(self, steps: np.ndarray) -> None:
        median = float(np.median(steps))
        near = steps[np.abs(steps - median) <= 0.5 * abs(median)]
        mean = float(near.mean())
        regular = mean > 0 and np.mean(np.abs(steps - mean) <= CLOSE * mean) >= REGULAR
        if not (regular and abs(mean - 1) > COARSE):
            self._wrong, self._patience = 0, LATER if regular else self._patience
            return
        self._wrong += 1
        if self._wrong >= self._patience:
            self._refuse(mean)

    def _refuse(self, mean: float) -> NoReturn:
        raise UsageError(
            f"the lines come every {mean * self.dt:.6g} s, the reference has {self.dt:.6g} s: log with that period, "
            "take a reference with this one, or correct the time column, which must be in s"
        )
