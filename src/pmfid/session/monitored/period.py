"""Whether stamps come with the sample period that a monitor was calibrated for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from pmfid.errors import UsageError

#: Steps from line to line in a group; least relative difference of their mean from the period that counts.
STEPS, COARSE = 25, 0.05
#: Successive wrong groups that end the run, before and after a right one: a late logger writes many lines at once.
FIRST, LATER = 1, 3
#: Longest step to a doubled line, which is no step [sample periods].
DOUBLED = 0.02
#: Least part of regular steps in a group with a period; largest distance of a regular step from their mean.
REGULAR, CLOSE = 0.8, 0.25
#: Samples after which the mean period is checked; its largest relative error.
LONG, FINE = 500, 0.005

#: A state, as an object for JSON.
Saved = dict[str, Any]


@dataclass
class Period:
    """Checks the period of stamps; dt: expected [s]. Every method raises UsageError once the period is another one."""

    dt: float
    _steps: list[float] = field(default_factory=list, init=False)
    _last: float = field(default=math.nan, init=False)
    _wrong: int = field(default=0, init=False)
    _patience: int = field(default=FIRST, init=False)
    _start: float = field(default=math.nan, init=False)
    _count: int = field(default=0, init=False)
    _checked: bool = field(default=False, init=False)

    def save_state(self) -> Saved:
        """The state, for JSON with NaN."""
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
        """Continues from a saved state. Raises KeyError, TypeError or ValueError for an invalid one."""
        self._steps, self._last = [float(step) for step in saved["steps"]], float(saved["last"])
        self._wrong, self._patience = int(saved["wrong"]), int(saved["patience"])
        self._start, self._count, self._checked = float(saved["start"]), int(saved["count"]), bool(saved["checked"])

    def line(self, time: float) -> None:
        """Adds the stamp [s] of any line."""
        step, self._last = (time - self._last) / self.dt, time
        if abs(step) > DOUBLED:
            self._steps.append(step)
        if len(self._steps) == STEPS:
            steps, self._steps = np.array(self._steps), []
            self._judge(steps)

    def sample(self, time: float) -> None:
        """Adds the stamp [s] of a line that is a sample."""
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
        """Adds samples without a line."""
        self._count += samples

    def restart(self) -> None:
        """Forgets the stamps so far, because the clock was set."""
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
