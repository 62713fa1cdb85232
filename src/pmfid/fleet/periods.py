"""Periods of a history: days, shifts, runs or any duration; what the segments of an axis say of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pmfid.fleet.series import BACKWARD, FORWARD, LOOKED_AT, MOVED, ONE_SIZE, Series, mean_of
from pmfid.fleet.source import seconds
from pmfid.status import Status

#: Of periods with a name: length and start of one of them [s].
NAMED = {"day": (86_400.0, 0.0), "shift": (28_800.0, 21_600.0)}
#: A pause from which on a new run begins [s]; of long segments, as long as one.
PAUSE = 60.0
#: Status bits that a period reports if at least half of its segments have them.
REPORTED = (Status.FALLBACK, Status.UNMODELLED, Status.FEEDBACK, Status.DEAD_TIME)
#: Findings with which an error may exceed the standard error; a period with a change in it has two true values.
DOUBT = {"missing", "changed", "one_way", "one_size", *(str(bit.name).lower() for bit in REPORTED)}
#: Segments that have such a status from which on it is one of the axis, not of a time, and part of them: a right model
#: is unmodelled in one of fifty, late or under feedback in up to one of ten; a change is in one or two more.
SEVERAL, SHARE = 3, {Status.UNMODELLED: 0.1, Status.DEAD_TIME: 0.25, Status.FEEDBACK: 0.25, Status.FALLBACK: 0.5}
#: Of the segments that had a second look the part that may be off: a change is in one.
LOOKS = 0.25
#: Standard deviations, and part of their size, by which estimates of one direction and the others may differ.
AGREES, SAME_WAY = 4.0, 0.02
#: Sample periods within this part of one another are the same.
SAME = 1e-3
#: Part of imputed samples from which on a period reports them as missing.
LOST = 0.01


@dataclass(frozen=True)
class Periods:
    """name: as it was asked for; length, start: [s], None: runs."""

    name: str
    length: float | None
    start: float = 0.0

    @classmethod
    def from_name(cls, name: str) -> Self:
        """Periods by name: "day", "shift" (of 8 hours, from 06:00 on), "run", or a duration. Raises UsageError for
        anything else."""
        if name == "run":
            return cls(name, None)
        return cls(name, *NAMED[name]) if name in NAMED else cls(name, seconds(name))

    def numbers(self, series: Series, segment: float) -> NDArray[np.int64]:
        """(n,) to which period each segment belongs; segment: its length [s]."""
        if self.length is None:
            pauses = series.start[1:] - series.end[:-1] > max(PAUSE, segment)
            return np.concatenate([[0], np.cumsum(pauses)]).astype(np.int64)[: series.start.size]
        middle = (series.start + series.end) / 2
        return np.floor((middle - self.start) / self.length).astype(np.int64)

    def begin(self, number: int, first: float) -> float:
        """When a period begins [s]; first: sample in it."""
        return first if self.length is None else self.start + number * self.length


def period_rows(
    axis: str,
    kind: str,
    series: Series,
    names: Sequence[str],
    periods: Periods,
    segment: float,
    codes: Collection[tuple[float, str]],
) -> Iterator[dict[str, object]]:
    """A row for each period of an axis; kind: its type; codes: times [s] and names of findings of its rows."""
    numbers, always = periods.numbers(series, segment), standing(series)
    for number in np.unique(numbers):
        part = series[numbers == number]
        begin = periods.begin(int(number), float(part.start[0]))
        end = float(part.end[-1]) if periods.length is None else begin + periods.length
        own = always | {code for at, code in codes if not at < begin and at < end}
        yield _row(axis, kind, part, names, begin, own)


def _row(axis: str, kind: str, part: Series, names: Sequence[str], begin: float, codes: set[str]) -> dict[str, object]:
    used = part[part.usable]
    theta, std = mean_of(used)
    lost = float(np.average(part.lost, weights=part.samples))
    findings = codes | codes_of(part)
    row: dict[str, object] = {"axis": axis, "type": kind, "period": begin}
    row |= {"first": float(part.start[0]), "last": float(part.end[-1]), "samples": int(part.samples.sum())}
    row |= {"segments": int(used.start.size), "lost": lost, "dt": float(np.median(part.dt))}
    for i, name in enumerate(names):
        row |= {name: float(theta[i]), f"{name}_std": float(std[i])}
    return row | {"quality": quality_of(int(used.start.size), findings), "findings": " ".join(sorted(findings))}


def quality_of(segments: int, codes: Collection[str]) -> str:
    """The quality of an estimate from this number of usable segments with these findings."""
    return "none" if not segments else "doubt" if DOUBT.intersection(codes) else "good"


def standing(series: Series) -> set[str]:
    """Findings of a whole axis: a wrong equation shows only in some moves, by chance."""
    used = series[series.known]
    many = {bit: np.count_nonzero(used.status & int(bit)) for bit in REPORTED}
    which = (bit for bit in REPORTED if many[bit] >= max(SEVERAL, SHARE[bit] * used.start.size))
    names = {str(bit.name).lower() for bit in which} | ({"one_way"} if _uneven(used) else set())
    looked_at, moved = (np.count_nonzero(used.status & bit) for bit in (LOOKED_AT, MOVED))
    return names | ({"unmodelled"} if moved > LOOKS * looked_at else set())


def _uneven(used: Series) -> bool:
    """Do segments of one direction contradict the others, as with a load, or is there only one direction?"""
    for bit in (FORWARD, BACKWARD):
        own = (used.status & bit) != 0
        if np.all(own) and own.size:
            return True
        if np.any(own):
            (one, std), (rest, other) = mean_of(used[own]), mean_of(used[~own])
            apart = np.abs(one - rest)
            if np.any((apart > AGREES * np.hypot(std, other)) & (apart > SAME_WAY * np.abs(rest))):
                return True
    return False


def codes_of(part: Series) -> set[str]:
    """Findings of some segments."""
    used = part[part.usable]
    found = {"missing"} if np.average(part.lost, weights=part.samples) > LOST else set()
    if np.ptp(part.dt) > SAME * np.max(part.dt):
        found.add("mixed_dt")
    status = Counter(bit for bit in REPORTED for one in used.status if int(one) & bit)
    found |= {str(bit.name).lower() for bit, many in status.items() if 2 * many >= used.start.size}
    found |= {"one_size"} if np.all(part.status & ONE_SIZE) else set()
    if not used.start.size:
        occurred = int(np.bitwise_or.reduce(part.status))
        found |= {str(bit.name).lower() for bit in Status if bit & occurred}
    return found
