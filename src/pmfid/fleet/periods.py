"""Periods of a history: days, shifts, runs or any duration; what the segments of an axis say of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pmfid.fleet.series import Series, mean_of
from pmfid.fleet.source import seconds
from pmfid.status import Status

#: Of periods with a name: length and start of one of them [s].
NAMED = {"day": (86_400.0, 0.0), "shift": (28_800.0, 21_600.0)}
#: A pause from which on a new run begins [s]; of long segments, as long as one.
PAUSE = 60.0
#: Status of segments that is told of a period where at least half of its segments have it.
TOLD = (Status.FALLBACK, Status.UNMODELLED, Status.FEEDBACK, Status.DEAD_TIME)
#: Findings with which an estimate may be further off than its bar says; a period with a change in it has two truths.
DOUBT = {"missing", "changed", *(str(bit.name).lower() for bit in TOLD)}
#: Sample periods within this part of one another are the same.
SAME = 1e-3
#: Part of the samples that is filled in, from which on that is told.
LOST = 0.01


@dataclass(frozen=True)
class Periods:
    """name: as it was asked for; length, start: [s], None: runs."""

    name: str
    length: float | None
    start: float = 0.0

    @classmethod
    def of(cls, name: str) -> Self:
        """Of "day", "shift" (of 8 hours, from 06:00 on), "run", or a duration. Raises UsageError for anything else."""
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
    numbers = periods.numbers(series, segment)
    for number in np.unique(numbers):
        part = series[numbers == number]
        begin = periods.begin(int(number), float(part.start[0]))
        end = float(part.end[-1]) if periods.length is None else begin + periods.length
        own = {code for at, code in codes if not at < begin and at < end}
        yield _row(axis, kind, part, names, begin, own)


def _row(axis: str, kind: str, part: Series, names: Sequence[str], begin: float, codes: set[str]) -> dict[str, object]:
    used = part[part.usable]
    theta, std = mean_of(used)
    lost = float(np.average(part.lost, weights=part.samples))
    told = codes | _codes(part, used, lost)
    row: dict[str, object] = {"axis": axis, "type": kind, "period": begin}
    row |= {"first": float(part.start[0]), "last": float(part.end[-1]), "samples": int(part.samples.sum())}
    row |= {"segments": int(used.start.size), "lost": lost, "dt": float(np.median(part.dt))}
    for i, name in enumerate(names):
        row |= {name: float(theta[i]), f"{name}_std": float(std[i])}
    quality = "none" if not used.start.size else "doubt" if told & DOUBT else "good"
    return row | {"quality": quality, "findings": " ".join(sorted(told))}


def _codes(part: Series, used: Series, lost: float) -> set[str]:
    found = {"missing"} if lost > LOST else set()
    if np.ptp(part.dt) > SAME * np.max(part.dt):
        found.add("mixed_dt")
    status = Counter(bit for bit in TOLD for one in used.status if int(one) & bit)
    found |= {str(bit.name).lower() for bit, many in status.items() if 2 * many >= used.start.size}
    if not used.start.size:
        occurred = int(np.bitwise_or.reduce(part.status))
        found |= {str(bit.name).lower() for bit in Status if bit & occurred}
    return found
