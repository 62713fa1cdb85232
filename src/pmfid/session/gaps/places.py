"""The used rows of a record, and their places on an even grid of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.session.clock import even_grid, sample_period, time_factor
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from pmfid.session.record_config import RecordConfig

Number = TypeVar("Number", bound=np.generic)
#: Longest step without a missing sample, in medians.
MISSING = 1.5
#: Largest distance of a step from a whole number of periods on an even grid [periods].
NEAR = 0.3
#: Longest step that determines the period [periods]: a pause need not be a whole number.
SHORT = 5
#: Relative accuracy of the period.
SETTLED = 1e-9
#: Largest standard deviation of stamps around a grid [periods]; random stamps have 0.29.
SCATTER = 0.2
#: A row within EARLY periods after another one is odd if no larger part of the rows than RARE is.
EARLY, RARE = 0.3, 0.001
#: Most iterations between grid and places.
TURNS = 5
#: Least part of the steps of a grid that are single periods.
SINGLE = 0.3
#: Longest gap on the grid [samples]. Longer gaps are shortened: the motion restarts after a gap of any length.
LONGEST = 1000


@dataclass(frozen=True)
class PlacedRows:
    """The used rows (m,) of a record, the places (m,) of these samples on a grid of period dt [s], and notes for
    people."""

    rows: NDArray[np.intp]
    places: NDArray[np.intp]
    dt: float
    notes: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Does every place have its sample?"""
        return bool(self.places.size == self.places[-1] + 1)


def place_rows(time: Floats | None, kept: Flags, repeated: Flags, config: RecordConfig) -> PlacedRows:
    """The rows `kept` (N,) on a grid, by time (N,) in the unit of its column or at a constant period. repeated (N,):
    rows with the values of the previous row. Raises UsageError for a time without an even grid."""
    if time is None:
        rows = np.flatnonzero(kept)
        return PlacedRows(rows, _shorten_gaps(rows), *sample_period(None, config))
    rows, repeats = _drop_repeats(time, repeated, np.flatnonzero(np.isfinite(time)))
    rows, early = _drop_early(time, rows)
    stamps, places = _take_rows(time, rows), None
    if not (_steady(stamps) or even_grid(stamps)[1]):
        found = _places(stamps)
        if found is not None:
            places, period = found
            stamps = stamps[0] + period * np.arange(places[-1] + 1)
    dt, notes = sample_period(stamps, config)  # which refuses what is on no grid
    counts = kept[rows]
    places = np.flatnonzero(counts) if places is None else places[counts]
    return PlacedRows(_take_rows(rows, np.flatnonzero(counts)), _shorten_gaps(places), dt, (*repeats, *early, *notes))


def _take_rows(values: NDArray[Number], rows: NDArray[np.intp]) -> NDArray[Number]:
    """The values (N,) at rising rows (n,); no copy if these are all rows."""
    return values if rows.size == values.size else values[rows]


def left_out(
    time: Floats | None, samples: int, config: RecordConfig, mask: Floats | None
) -> tuple[Flags, tuple[str, ...]]:
    """(N,): the rows that [record] mask and exclude leave out, and notes for people; mask (N,): that column."""
    out, notes = np.zeros(samples, bool), []
    if mask is not None:
        out |= ~(mask == 0)
        notes.append(f"{np.count_nonzero(out)} rows are left out by the mask {config.mask!r}")
    if config.exclude:
        t = np.arange(samples) * (config.dt or 0.0) if time is None else time * time_factor(config)
        inside = np.zeros(samples, bool)
        for first, last in config.exclude:
            inside |= (t >= first) & (t <= last)
        notes.append(f"{np.count_nonzero(inside)} rows are left out by exclude")
        out |= inside
    return out, tuple(notes)


def _steady(time: Floats) -> bool:
    """Does the time (n,) rise without a step in which samples are missing?"""
    steps = np.diff(time)
    return bool(steps.size and np.min(steps) > 0 and np.max(steps) <= MISSING * np.median(steps))


def _drop_repeats(time: Floats, repeated: Flags, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """The rows without repetitions of the previous row with the same time."""
    again = np.r_[False, np.diff(_take_rows(time, rows)) == 0] & _take_rows(repeated, rows)
    count = int(np.count_nonzero(again))
    if not count:
        return rows, ()
    note = "rows repeat the row before, time and all: they are" if count > 1 else "row repeats the row before: it is"
    return rows[~again], (f"{count} {note} left out",)


def _drop_early(time: Floats, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """The rows without the few that closely follow another one, as at the start of a logger: no grid has a place for
    them."""
    steps = np.diff(_take_rows(time, rows))
    early = np.r_[False, (steps > 0) & (steps < EARLY * np.median(steps))] if steps.size else np.zeros(rows.size, bool)
    count = int(np.count_nonzero(early))
    if not 0 < count <= max(1, RARE * rows.size):
        return rows, ()
    note = "rows come" if count > 1 else "row comes"
    return rows[~early], (f"{count} {note} less than {EARLY:g} of a period after another: left out",)


def _places(time: Floats) -> tuple[NDArray[np.intp], float] | None:
    """Places (n,) of rising stamps (n,) on an even grid, from 0 on, and its period; None without a grid.

    Each step is nearly a whole number of periods. If the stamps scatter more, a line through all stamps gives the grid.
    """
    steps = np.diff(time)
    if not (steps.size and np.min(steps) > 0):
        return None
    period = float(np.median(steps))
    period = float(np.mean(steps[np.abs(steps - period) <= (MISSING - 1) * period]))
    for _ in range(TURNS):
        numbers = np.maximum(1, np.rint(steps / period)).astype(np.intp)
        short = numbers <= SHORT
        before, period = period, float(np.sum(steps[short]) / np.sum(numbers[short]))
        if abs(period - before) <= SETTLED * period:
            break
    places = np.r_[0, np.cumsum(numbers)]
    if np.mean(numbers == 1) < SINGLE:
        return None
    if np.max(np.abs(steps / period - numbers)[short]) <= NEAR:
        return places, period
    return _place_by_line(time, places)


def _place_by_line(time: Floats, places: NDArray[np.intp]) -> tuple[NDArray[np.intp], float] | None:
    """Places and period for stamps that scatter by chance, from places (n,) that are nearly right."""
    for _ in range(TURNS):
        period, start = np.polyfit(places, time - time[0], 1)
        at = (time - time[0] - start) / period
        found = np.rint(at).astype(np.intp)
        if np.array_equal(found, places):
            break
        places = found
    rises = bool(np.min(np.diff(found)) > 0)
    return (found - found[0], float(period)) if rises and np.std(at - found) < SCATTER else None


def _shorten_gaps(places: NDArray[np.intp]) -> NDArray[np.intp]:
    """Places with gaps of at most LONGEST samples."""
    steps = np.diff(places, prepend=places[:1])
    return np.cumsum(np.minimum(steps, LONGEST + 1, out=steps), out=steps)
