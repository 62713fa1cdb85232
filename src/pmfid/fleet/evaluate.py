"""The work on rows of a history: `evaluate` turns the rows of some axes into rows of estimates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pmfid import __version__
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.fleet.edge_segments import cut_edge_stretches, estimate_edge_batch, split_at_missing_rows
from pmfid.fleet.segments import RecordPiece, Stretch, cut_stretches, estimate_batch, look_for_forces
from pmfid.fleet.series import FORCES
from pmfid.fleet.settings import Settings
from pmfid.fleet.source import AXIS, TEMPERATURE, TIME, SourceColumns
from pmfid.fleet.survey import RowProblem
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table
from pmfid.types import Floats

Schema = dict[str, pl.DataType | type[pl.DataType]]


@dataclass(frozen=True)
class Work:
    """The work on rows, with its settings and columns."""

    settings: Settings
    columns: SourceColumns
    version: str = __version__

    def evaluate(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the segments of some axes, and the problems with their rows, in the columns of `schema`.

        `frame` has the columns of `source`, in any order, and whole hours of each axis. Raises UsageError if another
        version of the package has prepared the work.
        """
        if self.version != __version__:
            raise UsageError(
                f"the executors have pmfid {__version__}, but the driver has {self.version}: install the same version "
                "on both"
            )
        pieces, problems = pieces_of(frame, self.columns)
        rows, found = solve(pieces, self.settings)
        reports = pl.DataFrame([asdict(one) for one in (*problems, *found)], PROBLEM)
        return pl.concat([pl.DataFrame(schema=self.schema), rows, reports], how="diagonal")

    @property
    def schema(self) -> Schema:
        """Columns of the result. A row with a `code` is a problem, any other row a segment."""
        return segment_schema(self.settings) | PROBLEM

    def split(self, rows: pl.DataFrame) -> tuple[pl.DataFrame, list[RowProblem]]:
        """Return the segments in results of `evaluate`, in the order of axes and time, and the problems."""
        reports = rows.filter(pl.col("code").is_not_null()).select(*PROBLEM)
        problems = [RowProblem(**row) for row in reports.iter_rows(named=True)]
        return rows.filter(pl.col("code").is_null()).drop("part", "code", "text", "at").sort(AXIS, "start"), problems


#: Columns of a problem.
PROBLEM: Schema = {
    AXIS: pl.String,
    "part": pl.String,
    "code": pl.String,
    "text": pl.String,
    "at": pl.Float64,
}


def pieces_of(frame: pl.DataFrame, columns: SourceColumns) -> tuple[Iterator[RecordPiece], list[RowProblem]]:
    """Return the pieces of rows in any order, and the problems of repeated rows.

    Of equal rows one is kept, of contradictory rows none.
    """
    frame = frame.select(columns.carried)
    runs = frame[AXIS].rle().struct
    if runs.field("value").n_unique() < runs.field("value").len():
        frame = frame.sort(AXIS, maintain_order=True)
        runs = frame[AXIS].rle().struct
    ends = np.cumsum(runs.field("len").to_numpy())
    problems, axes = list[RowProblem](), list[tuple[str, Floats, dict[str, Floats]]]()
    for axis, end, many in zip(runs.field("value").to_list(), ends.tolist(), runs.field("len").to_list(), strict=True):
        own = frame[end - many : end]
        time = own[TIME].to_numpy()
        if not np.all(time[1:] > time[:-1]):
            own, found = _order_rows(own, axis)
            problems += found
            time = own[TIME].to_numpy()
        if time.size:
            axes.append((axis, time, {columns.named[name]: own[name].to_numpy() for name in columns.carried[2:]}))
    return (piece for one in axes for piece in _cut_rows(*one, columns.time)), problems


def _order_rows(own: pl.DataFrame, axis: str) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Sort the rows of an axis, without repeated and contradictory rows. The order of files has no effect."""
    own = own.sort(TIME, *own.columns[2:])
    different = own.unique(maintain_order=True)
    kept = different.filter(pl.col(TIME).is_unique())
    clashing = own.join(different.filter(pl.col(TIME).is_duplicated()), on=TIME, how="semi")
    again = own.join(kept, on=TIME, how="semi").filter(~pl.col(TIME).is_first_distinct())
    texts = {
        "duplicates": (again, "rows are repeated without a difference: one of each counts"),
        "contradictions": (clashing, "rows repeat the time of another row with other values: they are left out"),
    }
    return kept, [
        RowProblem(axis, "", code, f"{rows.height} {text}", float(rows[TIME][0]))
        for code, (rows, text) in texts.items()
        if rows.height
    ]


def _cut_rows(axis: str, time: Floats, others: Mapping[str, Floats], name: str) -> Iterator[RecordPiece]:
    """Yield the pieces of the rows of an axis, in order: records without a gap within an hour.

    `name` is the name of the time in the table of a piece.
    """
    ends = np.flatnonzero(np.diff(np.floor(time / TUNING.hour))) + 1
    for first, last in zip([0, *ends], [*ends, time.size], strict=True):
        cuts = _find_gaps(time[first:last]) + first
        for low, high in zip([first, *cuts], [*cuts, last], strict=True):
            table = {key: values[low:high] for key, values in others.items()}
            yield RecordPiece(axis, float(time[low]), {name: time[low:high] - time[low], **table})


def _find_gaps(time: Floats) -> NDArray[np.intp]:
    """Return the rows (k,) after a gap, from rising times (n,) [s]."""
    steps = np.diff(time)
    if steps.size == 0 or steps.max() <= TUNING.rows_apart * steps.min():  # no median can be smaller
        return np.empty(0, np.intp)
    return np.flatnonzero(steps > TUNING.rows_apart * np.median(steps)) + 1


def longest_tables(frame: pl.DataFrame, columns: SourceColumns) -> Iterator[Table]:
    """Yield the longest piece of each axis in the rows of some axes, in the order of their names."""
    longest = dict[str, RecordPiece]()
    for piece in pieces_of(frame, columns)[0]:
        before = longest.setdefault(piece.axis, piece)
        if len(piece.table[columns.time]) > len(before.table[columns.time]):  # type: ignore[arg-type]
            longest[piece.axis] = piece
    yield from (longest[axis].table for axis in sorted(longest))


def segment_schema(settings: Settings) -> Schema:
    """Return the columns of segments: their axis, times and sample period [s], the lost part of the samples, status and
    parameters with standard deviations, and the forces that the model may lack."""
    kinds: Schema = {"axis": pl.String, "start": pl.Float64, "end": pl.Float64}
    kinds |= {"samples": pl.Int64, "dt": pl.Float64, "lost": pl.Float64, TEMPERATURE: pl.Float64, "status": pl.Int64}
    for name in settings.estimator.names:
        kinds |= {name: pl.Float64, f"{name}_std": pl.Float64}
    return kinds | {FORCES: pl.List(pl.Float64)}


def solve(pieces: Iterable[RecordPiece], settings: Settings) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Return the segments of pieces, in the order of axes and time. A piece that is no record is a problem of its
    axis."""
    problems = list[RowProblem]()
    groups: dict[tuple[float, float, int], list[Stretch]] = defaultdict(list)
    edges = isinstance(settings.estimator, REdge)
    if edges:
        pieces = (part for piece in pieces for part in split_at_missing_rows(piece, settings))
    for piece in pieces:
        try:
            for one in cut_edge_stretches(piece, settings) if edges else cut_stretches(piece, settings):
                groups[one.dt, one.resolution, one.u.size].append(one)
        except (UsageError, NotIdentifiableError) as error:
            problems.append(RowProblem(piece.axis, "", "no_record", " ".join(str(error).split()), piece.start))
    frames, estimated = [pl.DataFrame(schema=segment_schema(settings))], list[Stretch]()
    for (dt, resolution, size), group in groups.items():
        many = max(1, (TUNING.edges_batch if edges else TUNING.segments_batch) // size)
        try:
            estimator = settings.adapt_estimator(dt, resolution)
            frames += [_estimate(group[k : k + many], estimator) for k in range(0, len(group), many)]
            estimated += group
        except UsageError as error:
            reason = " ".join(str(error).split())
            problems += [RowProblem(one.axis, "", "no_estimate", reason, one.start) for one in group]
    rows = pl.concat(frames, how="diagonal")
    return _add_forces(rows, estimated, settings).sort("axis", "start"), problems


def _add_forces(rows: pl.DataFrame, stretches: Sequence[Stretch], settings: Settings) -> pl.DataFrame:
    """Return the rows of stretches with the forces that their model may lack."""
    names = settings.estimator.names
    theta, std = (rows.select(name + end for name in names).to_numpy() for end in ("", "_std"))
    found = look_for_forces(stretches, theta, std, rows["status"].to_numpy().astype(np.uint32), settings)
    return rows.with_columns(pl.Series(FORCES, found, pl.List(pl.Float64)))


def _estimate(stretches: Sequence[Stretch], estimator: RecursiveEstimator | REdge) -> pl.DataFrame:
    """Return the estimates of stretches of one length."""
    if isinstance(estimator, REdge):
        theta, std, status = estimate_edge_batch(stretches, estimator)
    else:
        theta, std, status = estimate_batch(stretches, estimator)
    facts = ("axis", "start", "end", "samples", "dt", "lost", TEMPERATURE)
    columns: dict[str, object] = {name: [getattr(one, name) for one in stretches] for name in facts}
    columns["status"] = status.astype(np.int64)
    for i, name in enumerate(estimator.names):
        columns |= {name: theta[:, i], f"{name}_std": std[:, i]}
    return pl.DataFrame(columns)
