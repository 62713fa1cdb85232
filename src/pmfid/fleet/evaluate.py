"""The work on rows of a history: `evaluate` turns the rows of an axis into rows of estimates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pmfid import __version__
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.fleet.segments import RecordPiece, Stretch, cut_stretches, estimate_batch, look_for_forces
from pmfid.fleet.series import FORCES
from pmfid.fleet.settings import Settings
from pmfid.fleet.source import AXIS, SECONDS, TEMPERATURE, TIME, SourceColumns
from pmfid.fleet.survey import RowProblem
from pmfid.fleet.tuning import TUNING
from pmfid.io.tables import Table
from pmfid.types import Floats

Schema = Mapping[str, pl.DataType | type[pl.DataType]]
#: Columns of a segment before its parameters: times and sample period [s], and the lost part of the samples.
SEGMENT: Schema = {
    AXIS: pl.String,
    "start": pl.Float64,
    "end": pl.Float64,
    "samples": pl.Int64,
    "dt": pl.Float64,
    "lost": pl.Float64,
    TEMPERATURE: pl.Float64,
    "status": pl.Int64,
}
#: Columns of a problem.
PROBLEM: Schema = {AXIS: pl.String, "part": pl.String, "code": pl.String, "text": pl.String, "at": pl.Float64}


@dataclass(frozen=True)
class Work:
    """The work on rows, with its settings and columns."""

    settings: Settings
    columns: SourceColumns
    version: str = __version__

    @property
    def schema(self) -> Schema:
        """Columns of the result. A row with a `code` is a problem, any other row a segment."""
        names = [name + end for name in self.settings.estimator.names for end in ("", "_std")]
        return {**SEGMENT, **dict.fromkeys(names, pl.Float64), FORCES: pl.List(pl.Float64), **PROBLEM}

    def evaluate(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the segments of an axis, and the problems with its rows, in the columns of `schema`.

        `frame` has the columns of `source`, in any order, and whole hours of the axis. Raises UsageError if another
        version of the package has prepared the work.
        """
        if self.version != __version__:
            raise UsageError(
                f"the executors have pmfid {__version__}, but the driver has {self.version}: install the same version "
                "on both"
            )
        axis = str(frame[AXIS][0])
        rows, problems = _order_rows(frame, self.columns)
        frames, estimated = [pl.DataFrame(schema=self.schema)], list[Stretch]()
        for (dt, resolution, size), group in self._cut(axis, rows, problems).items():
            many = max(1, TUNING.segments_batch // size)
            try:
                estimator = self.settings.adapt_estimator(dt, resolution)
                frames += [_estimate(group[k : k + many], estimator) for k in range(0, len(group), many)]
                estimated += group
            except UsageError as error:
                reason = " ".join(str(error).split())
                problems += [RowProblem(axis, "", "no_estimate", reason, one.start) for one in group]
        segments = self._add_forces(pl.concat(frames, how="diagonal"), estimated)
        reports = pl.DataFrame([asdict(one) for one in problems], PROBLEM)
        return pl.concat([segments.with_columns(axis=pl.lit(axis)), reports], how="diagonal")

    def _cut(
        self, axis: str, rows: pl.DataFrame, problems: list[RowProblem]
    ) -> dict[tuple[float, float, int], list[Stretch]]:
        """Return the stretches of rows by sample period, resolution and size. Add pieces without any to `problems`."""
        groups: dict[tuple[float, float, int], list[Stretch]] = defaultdict(list)
        for piece in _cut_rows(rows, self.columns):
            try:
                for one in cut_stretches(piece, self.settings):
                    groups[one.dt, one.resolution, one.u.size].append(one)
            except (UsageError, NotIdentifiableError) as error:
                problems.append(RowProblem(axis, "", "no_record", " ".join(str(error).split()), piece.start))
        return groups

    def _add_forces(self, rows: pl.DataFrame, stretches: Sequence[Stretch]) -> pl.DataFrame:
        """Return the rows of stretches with the forces that their model may lack."""
        names = self.settings.estimator.names
        theta, std = (rows.select(name + end for name in names).to_numpy() for end in ("", "_std"))
        found = look_for_forces(stretches, theta, std, rows["status"].to_numpy().astype(np.uint32), self.settings)
        return rows.with_columns(pl.Series(FORCES, found, pl.List(pl.Float64)))


def _estimate(stretches: Sequence[Stretch], estimator: RecursiveEstimator | REdge) -> pl.DataFrame:
    """Return the estimates of stretches of one length."""
    theta, std, status = estimate_batch(stretches, estimator)
    facts = ("start", "end", "samples", "dt", "lost", TEMPERATURE)
    columns: dict[str, object] = {name: [getattr(one, name) for one in stretches] for name in facts}
    columns["status"] = status.astype(np.int64)
    for i, name in enumerate(estimator.names):
        columns |= {name: theta[:, i], f"{name}_std": std[:, i]}
    return pl.DataFrame(columns)


def split_results(rows: pl.DataFrame) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Return the segments in results of `Work.evaluate`, in the order of axes and time, and the problems."""
    problems = rows.filter(pl.col("code").is_not_null()).select(*PROBLEM).iter_rows()
    segments = rows.filter(pl.col("code").is_null()).drop("part", "code", "text", "at").sort(AXIS, "start")
    return segments, [RowProblem(*row) for row in problems]


def longest_tables(frame: pl.DataFrame, columns: SourceColumns) -> Iterator[Table]:
    """Yield the longest piece of each axis in the rows of some axes, in the order of their names."""
    for rows in frame.sort(AXIS, maintain_order=True).partition_by(AXIS, maintain_order=True):
        pieces = list(_cut_rows(_order_rows(rows, columns)[0], columns))
        if pieces:
            yield max(pieces, key=lambda one: one.table[columns.time].size).table


def _order_rows(rows: pl.DataFrame, columns: SourceColumns) -> tuple[pl.DataFrame, list[RowProblem]]:
    """Sort the rows of an axis by time, and return the problems of repeated rows.

    Of equal rows one is kept, of contradictory rows none. The order of files has no effect.
    """
    rows = rows.select(columns.carried)
    time = rows[TIME].to_numpy()
    if np.all(time[1:] > time[:-1]):
        return rows, []
    rows = rows.sort(TIME, *columns.carried[2:])
    different = rows.unique(maintain_order=True)
    kept = different.filter(pl.col(TIME).is_unique())
    clashing = rows.join(different.filter(pl.col(TIME).is_duplicated()), on=TIME, how="semi")
    again = rows.join(kept, on=TIME, how="semi").filter(~pl.col(TIME).is_first_distinct())
    texts = {
        "duplicates": (again, "rows are repeated without a difference: one of each counts"),
        "contradictions": (clashing, "rows repeat the time of another row with other values: they are left out"),
    }
    return kept, [
        RowProblem(rows[AXIS][0], "", code, f"{found.height} {text}", float(found[TIME][0]))
        for code, (found, text) in texts.items()
        if found.height
    ]


def _cut_rows(rows: pl.DataFrame, columns: SourceColumns) -> Iterator[RecordPiece]:
    """Yield the pieces of the ordered rows of an axis: records without a gap within an hour."""
    time, table = rows[TIME].to_numpy(), {columns.named[name]: rows[name].to_numpy() for name in columns.carried[2:]}
    apart = TUNING.rows_apart if columns.age is None else TUNING.edges_apart
    ends = np.flatnonzero(np.diff(np.floor(time / SECONDS["h"]))) + 1
    for first, last in zip([0, *ends], [*ends, time.size], strict=True):
        cuts = _find_gaps(time[first:last], apart) + first
        for low, high in zip([first, *cuts], [*cuts, last], strict=True):
            if low < high:
                part = {name: values[low:high] for name, values in table.items()}
                yield RecordPiece(float(time[low]), {columns.time: time[low:high] - time[low], **part})


def _find_gaps(time: Floats, apart: float) -> NDArray[np.intp]:
    """Return the rows (k,) after a gap, a step longer than `apart` medians, from rising times (n,) [s].

    If too many steps are gaps, the clock changes, and only much longer steps are gaps.
    """
    steps = np.diff(time)
    if steps.size == 0 or steps.max() <= apart * steps.min():  # no median can be smaller
        return np.empty(0, np.intp)
    gaps = steps > apart * np.median(steps)
    if gaps.mean() > TUNING.most_missing:
        gaps = steps > TUNING.rows_apart * np.median(steps)
    return np.flatnonzero(gaps) + 1
