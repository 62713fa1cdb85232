"""Files and lakes with the rows of a history, and the times of the rows."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import signature
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import unquote

import numpy as np
import polars as pl

from pmfid.config.axis import Axis
from pmfid.errors import UsageError, did_you_mean, list_some
from pmfid.fleet.tuning import TUNING
from pmfid.io.arrow import FILE as ARROW
from pmfid.io.reading import ENDINGS, READERS, read_table
from pmfid.io.safety import readable, require_extra
from pmfid.io.tables import LONGEST_CELL, table_of
from pmfid.pipeline.edges import takes_edges
from pmfid.records.clock import CLOCK_EPOCHS, UNITS, time_factor

#: Length of each unit of time [s].
SECONDS = UNITS | {"min": 60.0, "h": 3600.0, "d": 86_400.0}
#: Files that every history writes into its folder.
RESULTS = {"periods.parquet", "axes.parquet", "problems.parquet"}


def walk_folder(folder: Path) -> tuple[list[Path], list[Path], list[Path]]:
    """Return the folders, all other entries in them, and the folders that cannot be listed.

    The other entries include pipes and broken links. The results of a history are left out. A folder with several links
    counts once, by the first of its names.
    """
    folders, others, closed, seen = list[Path](), list[Path](), list[Path](), set[str]()

    def note(error: OSError) -> None:
        closed.append(Path(error.filename))

    for name, below, names in os.walk(folder, onerror=note, followlinks=True):
        if (real := os.path.realpath(name)) in seen or set(names) >= RESULTS:
            below.clear()
            continue
        seen.add(real)
        below.sort()
        folders.append(Path(name))
        others += [Path(name) / one for one in names]
    return folders, others, closed


#: Folders in which Delta Lake and Iceberg list their valid files.
DELTA, ICEBERG, METADATA = "_delta_log", "metadata", "*.metadata.json"


def check_no_table(folders: Sequence[Path]) -> None:
    """Raise UsageError if a folder of plain files is a table of a lake.

    Reading such a folder would take outdated files of the table as data.
    """
    logs = [one for one in folders if one.name == DELTA]
    logs += [one for one in folders if one.name == ICEBERG and any(one.glob(METADATA))]
    if not logs:
        return
    table, kind = min(log.parent for log in logs), "Delta" if logs[0].name == DELTA else "Iceberg"
    remedy = "give the folder of a single snapshot as SOURCE" if kind == "Delta" else "write it as plain Parquet"
    raise UsageError(
        f"{table}: the folder of a {kind} table also contains outdated files; {remedy}, or in Python "
        "give a Polars frame"
    )


def scan_delta(folder: Path) -> pl.LazyFrame:
    """Return the valid rows of a Delta table.

    Raises UsageError without the package deltalake, for a damaged log, and for features that Polars cannot read.
    """
    with require_extra("delta"):
        from deltalake import DeltaTable
    with readable("Delta"):
        return pl.scan_delta(DeltaTable(str(folder)))


#: End of an ISO 8601 time with an offset from UTC.
_OFFSET = r"([+-])(\d\d):?(\d\d)$"
_FORM = "%Y-%m-%d %H:%M:%S%.f"


def seconds_of(column: pl.Expr, name: str, kind: pl.DataType, factor: float) -> pl.Expr:
    """Return a time column as float64 [s], with missing values for invalid times.

    `kind` is the type of the column `name`. `factor` is the number of seconds per unit of a number. Valid are numbers,
    dates with a time, with or without a zone, durations, and text with a number or an ISO 8601 date. A time without a
    zone is in UTC. Raises UsageError for a day without a time, a time without a day, and other types.
    """
    if kind == pl.Datetime:
        return column.dt.epoch("ns").cast(pl.Float64) * SECONDS["ns"]
    if kind == pl.Duration:
        return column.cast(pl.Duration("ns")).cast(pl.Int64).cast(pl.Float64) * SECONDS["ns"]
    if kind in (pl.Date, pl.Time):
        raise UsageError(
            f"the column {name!r} has the type {kind} and contains only a part of a time; give a column "
            "with both the day and the time"
        )
    if not (kind.is_numeric() or kind == pl.String):
        raise UsageError(f"the column {name!r} must contain times, but its type is {kind}")
    number = column.cast(pl.Float64, strict=False)
    number = number if factor == 1 else number * factor
    return number if kind != pl.String else pl.coalesce(number, _parse_dates(column))


def _parse_dates(column: pl.Expr) -> pl.Expr:
    short = pl.when(column.str.len_bytes() <= LONGEST_CELL).then(column)  # a packed file may repeat a long text
    text = short.str.strip_chars().str.replace("T", " ", literal=True).str.replace(",", ".", literal=True)
    plain = text.str.replace(_OFFSET, "").str.strip_suffix("Z").str.strip_chars_end()
    # A day also ends in a sign and digits, but an offset follows only a time.
    plain = pl.when(text.str.contains(":")).then(plain)
    hours, minutes = (text.str.extract(_OFFSET, k).cast(pl.Float64, strict=False) for k in (2, 3))
    sign = pl.when(text.str.extract(_OFFSET, 1) == "-").then(-1.0).otherwise(1.0)
    ahead = (sign * (SECONDS["h"] * hours + SECONDS["min"] * minutes)).fill_null(0.0)
    stamps = plain.str.to_datetime(_FORM, time_unit="ns", strict=False)
    return stamps.dt.epoch("ns").cast(pl.Float64) * SECONDS["ns"] - ahead


def other_unit(first: float, last: float, factor: float) -> str:
    """Return the remedy if times [s] lie outside this century, and another unit turns them into plausible dates.

    In all other cases the remedy is empty. `factor` is the number of seconds per assumed unit.
    """
    if last < CLOCK_EPOCHS[1]:
        return ""
    fitting = [
        unit
        for unit, length in UNITS.items()
        if CLOCK_EPOCHS[0] <= first / factor * length and last / factor * length < CLOCK_EPOCHS[1]
    ]
    if not fitting:
        return ""
    return (
        f"the times would be dates of this century in the unit {fitting[0]}: give [record] time_unit "
        f'= "{fitting[0]}"; if other files have another unit, convert their times'
    )


#: Names of the columns of every frame that leaves this module.
AXIS, TIME, INPUT, OUTPUT, MASK, TYPE, AGE = "axis", "time", "input", "output", "mask", "type", "edge age"
TEMPERATURE = "temperature"
#: Name of a part that is no file.
FRAME = "the frame"
_DATES = ", or as ISO 8601 dates (UTC if they have no offset)"
#: Hive's and Spark's folder name for rows without a value.
_NOTHING = "__HIVE_DEFAULT_PARTITION__"


@dataclass(frozen=True)
class SourceColumns:
    """Names of the data's columns for axis, time, input and output, and optionally for mask, type, ages of edges and
    the temperature that friction follows.

    `factor` is the number of seconds per unit of a numeric time.
    """

    axis: str
    time: str
    input: str
    output: str
    mask: str | None
    type: str | None
    factor: float
    age: str | None
    temperature: str | None

    @classmethod
    def from_axis(cls, axis: Axis, by: str, kind: str | None = None) -> SourceColumns:
        """Return the columns that AXIS.toml names, with the column `by` of the axes' names and the column `kind` of
        their type.

        Raises UsageError if AXIS.toml names no time, or if its model is no machine.
        """
        record = axis.record
        if axis.model.kind == "transfer_function":
            raise UsageError("pmfid fleet history works on machines; for a transfer function use pmfid identify")
        if record.time is None:
            raise UsageError('[record] time is missing, and rows of many axes need a time: give time = "t"')
        if record.known_force:
            raise UsageError(
                "[record] known_force works for a single record; for a fleet, subtract the forces from the input column"
            )
        if record.exclude:
            raise UsageError(
                "[record] exclude works for a single record; for a fleet, leave out rows with a column, "
                "[record] mask, or remove exclude"
            )
        age = axis.encoder.edge_age if takes_edges(axis) else None
        columns = by, record.time, record.input, record.output, record.mask, kind
        return cls(*columns, time_factor(record), age, record.friction_temperature)

    @property
    def carried(self) -> list[str]:
        """Own names of the columns that an estimate needs."""
        return [AXIS, TIME, INPUT, OUTPUT, *(own for own, name in self._further if name is not None)]

    @property
    def own(self) -> SourceColumns:
        """The columns of rows that already have their own names, with times in s."""
        mask, age, temperature = (own if name else None for own, name in self._further)
        return SourceColumns(AXIS, TIME, INPUT, OUTPUT, mask, TYPE if self.type else None, 1.0, age, temperature)

    @property
    def named(self) -> dict[str, str]:
        """Map from the own names of the columns to the names in the data."""
        pairs = {AXIS: self.axis, TIME: self.time, INPUT: self.input, OUTPUT: self.output}
        others = (TYPE, self.type), *self._further
        return pairs | {own: name for own, name in others if name is not None}

    @property
    def _further(self) -> tuple[tuple[str, str | None], ...]:
        """Own names of the columns that some estimates need, and their names in the data."""
        return (MASK, self.mask), (AGE, self.age), (TEMPERATURE, self.temperature)


@dataclass(frozen=True)
class Part:
    """One file, or one frame in memory.

    `name` identifies the part in messages. `constants` has the values that the names of the folders give to all rows.
    `stamp` returns a text that changes with the content, and `listed` is the text when the part was listed.
    """

    name: str
    open: Callable[[], pl.LazyFrame]
    constants: Mapping[str, str] = field(default_factory=dict)
    stamp: Callable[[], str] = lambda: ""
    listed: str = ""

    @property
    def rewritten(self) -> bool:
        """Return whether the part has changed since it was listed."""
        return self.stamp() != self.listed

    def rows(self, columns: SourceColumns) -> pl.LazyFrame:
        """Return the rows of a part. Axis and type are text, and all other columns are float64.

        Times are in s. Raises UsageError for a column that is missing, or cannot be read as numbers.
        """
        with readable(Path(self.name).suffix or "frame"):
            frame = self.open()
            schema = frame.collect_schema()
        made = []
        for own, name in columns.named.items():
            if name in schema:
                made.append(_cast(own, name, schema[name], columns.factor))
            elif name in self.constants:
                made.append(_cast(own, name, pl.String(), columns.factor, pl.lit(self.constants[name])))
            else:
                known = [*schema, *self.constants]
                listed = f"the columns are {list_some(known)}{did_you_mean(name, known)}"
                raise UsageError(f"the data have no column {name!r}; {listed}")
        return frame.select(made)

    def other_types(self, columns: SourceColumns) -> list[str]:
        """Return sentences on columns with text in place of numbers, or with numbers of too few bits."""
        schema = self.open().collect_schema()
        texts = [name for name in (columns.time, columns.input, columns.output) if schema.get(name) == pl.String]
        notes = [
            (
                f"{name} contains text, read as numbers{_DATES * (name == columns.time)}: any other text "
                "counts as missing"
            )
            for name in texts
        ]
        if schema.get(columns.time) == pl.Float32:
            step = np.spacing(np.float32(CLOCK_EPOCHS[0]))
            notes.append(
                f"{columns.time} has 32 bits, which resolve a date only to {step:.0f} s: write the column as float64"
            )
        return notes


def _cast(own: str, name: str, kind: pl.DataType, factor: float, value: pl.Expr | None = None) -> pl.Expr:
    column = pl.col(name) if value is None else value
    if own in (AXIS, TYPE):
        if kind.is_nested():
            raise UsageError(f"the column {name!r} must contain names, but its type is {kind}")
        return _name(column, kind).alias(own)
    if own == TIME:
        return seconds_of(column, name, kind, factor).alias(own)
    if not (kind.is_numeric() or kind == pl.String or (kind == pl.Boolean and own != OUTPUT)):
        raise UsageError(f"the column {name!r} must contain numbers, but its type is {kind}")
    return column.cast(pl.Float64, strict=False).alias(own)


def _name(column: pl.Expr, kind: pl.DataType) -> pl.Expr:
    """Return names as text, with an empty text for no name.

    The number 7.0 becomes 7, because tables with missing values write integers in this form.
    """
    text = column.cast(pl.String, strict=False)
    if kind.is_float():
        whole = column.cast(pl.Int64, strict=False)
        return pl.when(column == whole).then(whole.cast(pl.String)).otherwise(text)
    return pl.when(text != "").then(text)


class SparkFrame(Protocol):
    """A DataFrame of Spark or of Spark Connect."""

    @property
    def sparkSession(self) -> object: ...


def is_spark(source: object) -> bool:
    """Return whether an object is a DataFrame of Spark or of Spark Connect."""
    kinds = type(source).__mro__
    return any(kind.__name__ == "DataFrame" and kind.__module__.startswith("pyspark.sql") for kind in kinds)


def parts_of(source: object, out: Path | None = None) -> list[Part]:
    """Return the parts of a file, a folder tree, or a frame (pandas, Polars or Arrow, lazy or not).

    `out` is a folder of results, which may lie in the source and is then left out. Raises UsageError for any other
    source, and for a folder without a readable file.
    """
    if isinstance(source, str | Path):
        return _files(Path(source), out)
    lazy = source if isinstance(source, pl.LazyFrame) else pl.DataFrame(dict(table_of(source))).lazy()
    return [Part(FRAME, lambda: lazy)]


def _files(source: Path, out: Path | None) -> list[Part]:
    if not source.exists():
        raise UsageError(f"{source}: no such file or folder exists; give the file or folder of the data set")
    if source.is_file():
        return [_part(source, source.parent)]
    if (source / DELTA).is_dir():
        table = scan_delta(source)
        return [Part(source.name, lambda: table)]
    folders, paths, closed = walk_folder(source)
    check_no_table(folders)
    known = {*READERS, *ENDINGS}
    own = None if out is None else out.resolve()
    data = (
        path for path in paths if path.suffix.lower() in known and (own is None or own not in path.resolve().parents)
    )
    # Engines write files with a leading dot or underscore in addition to the data.
    found = sorted(path for path in data if not any(part[:1] in "._" for part in path.relative_to(source).parts))
    if not found and not closed:
        raise UsageError(f"{source}: contains no file of a known format; put Parquet or Arrow files into this folder")
    return [_part(path, source) for path in (*found, *closed)]


def _part(path: Path, root: Path) -> Part:
    """Return one file as a part."""
    inside = path.relative_to(root)
    pairs = (part.partition("=") for part in inside.parent.parts if "=" in part)
    constants = {unquote(key): "" if value == _NOTHING else unquote(value) for key, _, value in pairs}
    name = inside.as_posix().encode("utf-8", "backslashreplace").decode()  # a file name may contain any bytes
    return Part(name, lambda: _open_file(path), constants, lambda: _stamp(path), _stamp(path))


def _kind(path: Path) -> str:
    return ENDINGS.get(path.suffix.lower(), path.suffix.lower())


def _stamp(path: Path) -> str:
    """Return the stamp of a file, or an empty text if the file no longer exists."""
    try:
        stat = path.stat()
    except OSError:
        return ""
    return f"{stat.st_size}-{stat.st_mtime_ns}"


def _open_file(path: Path) -> pl.LazyFrame:
    if not path.exists():
        raise UsageError(
            f"{path} leads nowhere: a link is broken, or the file was removed; restore the file, or remove the link"
        )
    if "\udc80" <= max(str(path)) <= "\udcff":  # bytes that are no text
        raise UsageError("its name is not UTF-8; rename it")
    if not path.is_file():
        raise UsageError("this is not a readable file or folder; remove it, or allow reading it")
    kind = _kind(path)
    if kind == ".parquet":
        return pl.scan_parquet(path, hive_partitioning=False, glob=False)
    if kind == ".arrow":
        with path.open("rb") as file:
            indexed = file.read(len(ARROW)) == ARROW
        if indexed:
            plain: dict[str, Any] = (
                {"glob": False} if "glob" in signature(pl.scan_ipc).parameters else {}
            )  # early versions lack it
            return pl.scan_ipc(path, hive_partitioning=False, **plain)
    return pl.DataFrame(dict(read_table(path))).lazy()


def seconds(text: str) -> float:
    """Parse a duration, such as "10 min", "1 h", "1.5 d" or a number of seconds. Raises UsageError for anything
    else."""
    number = text.strip().rstrip("abcdefghijklmnopqrstuvwxyzµ").strip()
    unit = text.strip()[len(number) :].strip() or "s"
    try:
        found = float(number) * SECONDS[unit]
    except (ValueError, KeyError):
        found = float("nan")
    if not TUNING.source_shortest <= found < float("inf"):
        raise UsageError(f"{text!r} is not a valid duration of a period; give a duration such as 600, 10min, 1h or 7d")
    return found
