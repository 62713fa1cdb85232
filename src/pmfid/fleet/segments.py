"""Estimates of segments, many axes side by side: the heavy work of a history, and a function of the rows alone.

Each piece starts from nothing, so its bits are those that it would have by itself, whatever runs beside it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.bridges import gaps_in
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.track import Tracks
from pmfid.fleet.rows import Piece
from pmfid.fleet.settings import Settings, quarter_of, record_at
from pmfid.fleet.survey import Problem
from pmfid.types import Counts, Floats

if TYPE_CHECKING:
    import polars as pl

#: Samples of a batch at most [axes times samples], and pieces: several vectors of the kernel.
BATCH, LANES = 2**23, 32
#: Quarters of a segment: an estimate has seen four, or all of a piece that has at least so many.
WHOLE, LEAST = 4, 1


@dataclass(frozen=True)
class Stretch:
    """Samples (n,) without a gap. lost: part of them that was filled in."""

    axis: str
    start: float
    dt: float
    resolution: float
    u: Floats
    counts: Counts
    lost: float


@dataclass(frozen=True)
class Segments:
    """Estimates of segments and what could not be used.

    rows: axis, start and end [s], samples, dt [s], lost (part of the samples), status at the end, and each parameter
    with its standard deviation, in the order of axes and time.
    """

    rows: pl.DataFrame
    problems: tuple[Problem, ...]


def solve(pieces: Iterable[Piece], settings: Settings) -> Segments:
    """The segments of pieces; what is no record is a problem of its axis."""
    import polars as pl

    problems = list[Problem]()
    groups: dict[tuple[float, float], list[Stretch]] = defaultdict(list)
    for piece in pieces:
        try:
            for stretch in _stretches(piece, settings):
                groups[stretch.dt, stretch.resolution].append(stretch)
        except (UsageError, NotIdentifiableError) as error:
            problems.append(Problem(piece.axis, "", "no_record", " ".join(str(error).split()), piece.start))
    frames = [empty(settings)]
    for (dt, resolution), stretches in groups.items():
        try:
            frames += _estimated(stretches, settings.at(dt, resolution), quarter_of(settings, dt))
        except UsageError as error:
            told = " ".join(str(error).split())
            problems += [Problem(one.axis, "", "no_estimate", told, one.start) for one in stretches]
        short = [one for one in stretches if one.u.size < LEAST * quarter_of(settings, dt)]
        problems += [_too_short(one, settings) for one in short]
    return Segments(pl.concat(frames).sort("axis", "start"), tuple(problems))


def _too_short(one: Stretch, settings: Settings) -> Problem:
    text = f"{one.u.size} samples without a gap are too few: an estimate takes {settings.segment / 4:.3g} s of them"
    return Problem(one.axis, "", "short", text, one.start)


def _stretches(piece: Piece, settings: Settings) -> list[Stretch]:
    record = record_at(piece.table, settings.axis)
    filled = np.zeros(record.u.size, bool) if record.there is None else ~record.there
    edges = [0, *(edge for gap in gaps_in(record.u) for edge in gap), record.u.size]
    found = []
    for first, last in zip(edges[0::2], edges[1::2], strict=True):
        if last > first:
            part = slice(first, last)
            start, lost = piece.start + first * record.dt, float(filled[part].mean())
            u, counts = record.u[part], record.counts[part]
            found.append(Stretch(piece.axis, start, record.dt, record.resolution, u, counts, lost))
    return found


def _estimated(stretches: Sequence[Stretch], estimator: RecursiveEstimator, quarter: int) -> list[pl.DataFrame]:
    """In batches of nearly the same length, the longest first."""
    usable = sorted((one for one in stretches if one.u.size >= LEAST * quarter), key=lambda one: -one.u.size)
    frames, start = [], 0
    while start < len(usable):
        samples = usable[start].u.size // quarter * quarter
        many = max(1, min(LANES, BATCH // samples))
        frames.append(_batch(usable[start : start + many], estimator, quarter, samples))
        start += many
    return frames


def _batch(stretches: Sequence[Stretch], estimator: RecursiveEstimator, quarter: int, samples: int) -> pl.DataFrame:
    """Shorter ones rest behind their end, where nothing is kept of them."""
    u = np.zeros((len(stretches), samples))
    counts = np.empty((len(stretches), samples), np.int64)
    for lane, one in enumerate(stretches):
        size = min(one.u.size, samples)
        u[lane, :size], counts[lane, :size] = one.u[:size], one.counts[:size]
        counts[lane, size:] = one.counts[size - 1]
    tracks = estimator.runner.side_by_side(len(stretches), workers=1).run(u, counts, quarter)
    ends = [_ends(min(one.u.size, samples) // quarter) for one in stretches]
    return _frame(stretches, tracks, ends, quarter)


def _ends(quarters: int) -> list[int]:
    """Quarters at which estimates are taken: whole segments; what is left at the end if it is half of one or all."""
    ends = list(range(WHOLE, quarters + 1, WHOLE))
    rest = quarters - len(ends) * WHOLE
    return [*ends, quarters] if rest >= WHOLE // 2 or not ends else ends


def _frame(stretches: Sequence[Stretch], tracks: Tracks, ends: Sequence[Sequence[int]], quarter: int) -> pl.DataFrame:
    import polars as pl

    lane = np.repeat(np.arange(len(stretches)), [len(one) for one in ends])
    end = np.concatenate([np.array(one) for one in ends])
    before = np.concatenate([np.array([0, *one[:-1]]) for one in ends])
    start, dt, lost = (np.array([getattr(one, name) for one in stretches])[lane] for name in ("start", "dt", "lost"))
    columns: dict[str, object] = {
        "axis": [stretches[int(k)].axis for k in lane],
        "start": start + before * quarter * dt,
        "end": start + end * quarter * dt,
        "samples": (end - before) * quarter,
        "dt": dt,
        "lost": lost,
        "status": tracks.status[lane, end - 1],
    }
    for i, name in enumerate(tracks.names):
        columns |= {name: tracks.theta[lane, end - 1, i], f"{name}_std": tracks.theta_std[lane, end - 1, i]}
    return pl.DataFrame(columns)


def empty(settings: Settings) -> pl.DataFrame:
    """No segments, with their columns."""
    import polars as pl

    kinds: dict[str, type[pl.DataType]] = {"axis": pl.String, "start": pl.Float64, "end": pl.Float64}
    kinds |= {"samples": pl.Int64, "dt": pl.Float64, "lost": pl.Float64, "status": pl.UInt32}
    for name in settings.estimator.names:
        kinds |= {name: pl.Float64, f"{name}_std": pl.Float64}
    return pl.DataFrame(schema=kinds)
