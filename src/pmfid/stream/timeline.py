"""Conversion of lines to samples on a regular grid."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, fields
from typing import Any, NoReturn

import numpy as np

from pmfid.errors import UsageError
from pmfid.stream.tuning import TUNING

#: Number of successive groups with a wrong period that end the run, before and after a right group. A late logger
#: writes many lines at once, which causes several wrong groups.
FIRST, LATER = 1, 3

#: A state as an object for JSON.
Saved = dict[str, Any]


class SavedFields:
    """A dataclass whose private fields are saved, as numbers, lists and flags."""

    def save_state(self) -> Saved:
        """Return the state for JSON with NaN."""
        return {name[1:]: getattr(self, name) for name in self._list_saved()}

    def restore(self, saved: Saved) -> None:
        """Continue from a saved state. Raises KeyError, TypeError or ValueError for an invalid state."""
        for name in self._list_saved():
            kind = type(getattr(self, name))
            setattr(self, name, kind(saved[name[1:]]))

    def _list_saved(self) -> list[str]:
        return [one.name for one in fields(self) if one.name.startswith("_")]  # type: ignore[arg-type]


@dataclass
class Period(SavedFields):
    """A check of the sample period in time stamps, with the expected period dt [s].

    Every method raises UsageError if the stamps have another period.
    """

    dt: float
    _steps: list[float] = field(default_factory=list, init=False)
    _last: float = field(default=math.nan, init=False)
    _wrong: int = field(default=0, init=False)
    _patience: int = field(default=FIRST, init=False)
    _start: float = field(default=math.nan, init=False)
    _count: int = field(default=0, init=False)
    _checked: bool = field(default=False, init=False)

    def line(self, time: float) -> None:
        """Add the stamp [s] of any line."""
        step, self._last = (time - self._last) / self.dt, time
        if abs(step) > TUNING.timeline_doubled:
            self._steps.append(step)
        if len(self._steps) == TUNING.timeline_steps:
            steps, self._steps = np.array(self._steps), []
            self._judge(steps)

    def sample(self, time: float) -> None:
        """Add the stamp [s] of a line that is a sample."""
        if math.isnan(self._start):
            self._start, self._count = time, 0
            return
        self._count += 1
        if self._count >= TUNING.rate_samples and not self._checked:
            self._checked = True
            mean = (time - self._start) / (self._count * self.dt)
            if abs(mean - 1) > TUNING.order_rate:
                self._refuse(mean)

    def slots(self, samples: int) -> None:
        """Add samples without a line."""
        self._count += samples

    def restart(self) -> None:
        """Forget the previous stamps, because the clock was set."""
        self._start, self._checked, self._patience = math.nan, False, FIRST

    def _judge(self, steps: np.ndarray) -> None:
        median = float(np.median(steps))
        near = steps[np.abs(steps - median) <= 0.5 * abs(median)]
        mean = float(near.mean())
        regular = mean > 0 and np.mean(np.abs(steps - mean) <= TUNING.timeline_close * mean) >= TUNING.timeline_regular
        if not (regular and abs(mean - 1) > TUNING.timeline_coarse):
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


BAD, REPEATED = "bad line", "repeated line"


@dataclass(frozen=True)
class Line:
    """The values of a line.

    `time` [s] is NaN without a time. An unusable `u` is NaN, and `problem` is then the reason. `further` is the
    time from the last edge of the encoder to the sample [s], or a temperature, and NaN without either.
    """

    time: float
    u: float
    counts: int
    problem: str = ""
    further: float = field(default=math.nan, compare=False)  # NaN is not equal to itself

    def as_list(self) -> list[float | int | str]:
        """Return the arguments of a line for JSON, as before further columns unless the line has one."""
        return [self.time, self.u, self.counts, self.problem, *([] if math.isnan(self.further) else [self.further])]


@dataclass(frozen=True)
class Sample:
    """A sample on the regular grid.

    `time` is in s. `u` is NaN if the sample is lost, and `counts` then holds the last counts. `missing` is the number
    of missing samples just before. `jump` is the change of the clock just before [s]. `further` is as
    in `Line`.
    """

    time: float
    u: float
    counts: int
    missing: int = 0
    jump: float = 0.0
    further: float = math.nan


@dataclass(frozen=True)
class Skipped:
    """A line that is not a sample.

    `time` is the time of the next expected sample [s]. `kind` is BAD or REPEATED.
    """

    time: float
    kind: str
    problem: str


Found = Sample | Skipped


@dataclass
class Timeline(SavedFields):
    """The regular grid of samples with a period dt [s], for lines with a time.

    `take` raises UsageError if the lines have another sample period, or if most_strays successive lines have no valid
    time.
    """

    dt: float
    _expected: float = field(default=math.nan, init=False)
    _held: list[Line] = field(default_factory=list, init=False)
    _unused: int = field(default=0, init=False)
    _strays: int = field(default=0, init=False)
    _counts: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.period = Period(self.dt)
        self.recent: deque[Line] = deque(maxlen=TUNING.remembered)

    def save_state(self) -> Saved:
        """Return the state for JSON with NaN."""
        lines = {"held": self._held, "recent": self.recent}
        texts = {name: [line.as_list() for line in some] for name, some in lines.items()}
        return super().save_state() | {"period": self.period.save_state()} | texts

    def restore(self, saved: Saved) -> None:
        """Continue from a saved state. Raises KeyError, TypeError or ValueError for an invalid state."""
        held, recent = ([Line(*entry) for entry in saved[name]] for name in ("held", "recent"))
        super().restore(saved | {"held": held})
        self.recent.extend(recent)
        self.period.restore(saved["period"])

    def take(self, line: Line) -> list[Found]:
        """Return the samples and skipped lines that are known after a line, in the order of time."""
        if math.isnan(line.time):
            return [self._skip(line.problem)]
        self.period.line(line.time)
        if math.isnan(self._expected):
            self._expected = line.time
        place = self._place(line.time)
        if place is not None:
            return self._regular(line, place)
        if line.problem:
            return [self._skip(line.problem)]
        return self._irregular(line)

    def _offset(self, time: float) -> float:
        return (time - self._expected) / self.dt

    def _place(self, time: float) -> int | None:
        """Return the place of a line, in samples after the expected sample. Unusable lines may take the places
        before the returned place.
        """
        offset = self._offset(time)
        place = min(max(0, round(offset)), self._unused + len(self._held))
        return place if abs(offset - place) < TUNING.timeline_near else None

    def _regular(self, line: Line, place: int) -> list[Found]:
        found: list[Found] = [Sample(self._expected + k * self.dt, math.nan, self._counts) for k in range(place)]
        self._expected += place * self.dt
        self.period.slots(place)
        held, self._held = self._held, []
        # Lines with an old time and new values are samples of a clock that was set back by a few periods.
        late = sum(
            other.time < self._expected - TUNING.timeline_near * self.dt and other not in self.recent for other in held
        )
        found += self._accept(line, late)
        for other in held:  # two lines have changed places
            fits = abs(self._offset(other.time)) < 0.5
            found += self._accept(other) if fits else [self._stray(other)]
        self._unused = 0
        return found

    def _accept(self, line: Line, missing: int = 0, jump: float = 0.0) -> list[Found]:
        """Return a line as the expected sample, and move the grid."""
        grid = self._expected + TUNING.timeline_follow * (line.time - self._expected)
        self._expected, self._strays = grid + self.dt, 0
        self.period.sample(line.time)
        if line.problem:
            lost = Sample(line.time, math.nan, self._counts, missing, jump)
            return [Skipped(line.time, BAD, line.problem), lost]
        self._counts = line.counts
        self.recent.append(line)
        return [Sample(line.time, line.u, line.counts, missing, jump, line.further)]

    def _irregular(self, line: Line) -> list[Found]:
        """Hold a line until further lines confirm its time."""
        follows = (
            bool(self._held)
            and TUNING.timeline_soonest < (line.time - self._held[-1].time) / self.dt < TUNING.timeline_latest
        )
        found = [] if follows else self._drop_held()
        self._held.append(line)
        self._strays += 1
        if self._strays >= TUNING.most_strays:
            raise UsageError(
                f"{TUNING.most_strays} consecutive lines have a time that does not continue the record, the last "
                f"{line.time:.9g} s: correct the time column, which must step by {self.dt:.6g} s, or drop [record] "
                "time and give [record] dt"
            )
        needed = TUNING.timeline_ahead if self._held[0].time > self._expected else TUNING.timeline_late
        return found + self._restart_grid() if len(self._held) >= needed else found

    def _restart_grid(self) -> list[Found]:
        """Return the held lines as samples of a new grid."""
        (first, *others), self._held, self._unused = self._held, [], 0
        jump = first.time - self._expected
        gap = 0 < jump <= TUNING.longest_gap
        missing = max(1, round(jump / self.dt)) if gap else 0
        self._expected = first.time
        if gap:
            self.period.slots(missing)
        else:
            self.period.restart()
        found = self._accept(first, missing, 0.0 if gap else jump)
        for line in others:
            lost = max(0, round(self._offset(line.time)))
            self._expected += lost * self.dt
            self.period.slots(lost)
            found += self._accept(line, lost)
        return found

    def _drop_held(self) -> list[Found]:
        held, self._held = self._held, []
        self._unused += len(held)
        return [self._stray(line) for line in held]

    def _stray(self, line: Line) -> Skipped:
        expected = self._expected
        kind, problem = (BAD, "later") if line.time > expected else (REPEATED, "earlier")
        return Skipped(expected, kind, f"its time {line.time:.9g} s is {problem} than the expected {expected:.9g} s")

    def _skip(self, problem: str) -> Skipped:
        self._unused += 1
        return Skipped(0.0 if math.isnan(self._expected) else self._expected, BAD, problem)
