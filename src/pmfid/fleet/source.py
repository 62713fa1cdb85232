"""A data set of many axes: its files, partitioned in any way, and which rows of which axis each of them has.

Every file is read by itself, so that one that is damaged, or has other columns, is named and costs nothing but its
rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from pmfid.errors import UsageError, did_you_mean
from pmfid.fleet.lake import check_no_table, delta_files, is_delta
from pmfid.fleet.times import seconds_of, too_coarse
from pmfid.fleet.walk import walk_folder
from pmfid.session.clock import EPOCHS, UNITS, time_factor
from pmfid.session.config import Axis
from pmfid.session.formats.arrow_file import FILE as ARROW
from pmfid.session.formats.reading import ENDINGS, READERS, read_table
from pmfid.session.formats.safety import readable
from pmfid.session.frames import table_of

if TYPE_CHECKING:
    import polars as pl

#: Names of the columns of every frame that leaves this module.
AXIS, TIME, INPUT, OUTPUT, MASK, TYPE = "axis", "time", "input", "output", "mask", "type"
#: Name of a part that is no file.
FRAME = "the frame"
_DATES = ", or as dates of ISO 8601 (UTC without an offset)"
#: What Hive and Spark name the folder of rows that have no value.
_NOTHING = "__HIVE_DEFAULT_PARTITION__"
#: Columns that are listed where one is missing.
_LISTED = 30
#: Rows of a file that are in memory at once: a row group may hold all of them.
WINDOW = 2**21
#: Of a period [s].
SHORTEST, LONGEST = 1.0, 1e9


@dataclass(frozen=True)
class Columns:
    """Names of the columns in the data: axis, time, input, output, and, where there are such, mask and type; factor:
    seconds per unit of a time that is a number."""

    axis: str
    time: str
    input: str
    output: str
    mask: str | None = None
    type: str | None = None
    factor: float = 1.0

    @classmethod
    def from_axis(cls, axis: Axis, by: str, kind: str | None = None) -> Columns:
        """Columns that AXIS.toml names, and the column `by` of the axes' names; kind: the column of their type. Raises
        UsageError if AXIS.toml names no time, or no axis of motion."""
        record = axis.record
        if axis.model.kind == "transfer_function":
            raise UsageError("the history of a fleet is of machines; of a transfer function use pmfid identify")
        if record.time is None:
            raise UsageError('[record] time is missing: rows of many axes need a time each, time = "t"')
        if record.exclude:
            raise UsageError(
                "[record] exclude is of one record; of a fleet leave out rows by a column, mask, or drop it"
            )
        return cls(by, record.time, record.input, record.output, record.mask, kind, time_factor(record))

    @property
    def named(self) -> dict[str, str]:
        """Own name -> name in the data."""
        pairs = {AXIS: self.axis, TIME: self.time, INPUT: self.input, OUTPUT: self.output}
        return pairs | {own: name for own, name in ((MASK, self.mask), (TYPE, self.type)) if name is not None}


@dataclass(frozen=True)
class Part:
    """One file, or one frame in memory. name: for people; stamp: changes with the content, empty: of a frame;
    constants: what the folders around it say of all its rows; stamp_now: the stamp as it is by now, None: of what
    cannot change; sliced: some of its rows are read without the others; first, many: its rows from which on, and how
    many, None: all."""

    name: str
    stamp: str
    open: Callable[[], pl.LazyFrame] = field(repr=False, compare=False)
    constants: Mapping[str, str] = field(default_factory=dict)
    stamp_now: Callable[[], str] | None = field(default=None, repr=False, compare=False)
    sliced: bool = False
    first: int = 0
    many: int | None = None

    @property
    def rewritten(self) -> bool:
        """Has it been written to since it was listed?"""
        return self.stamp_now is not None and self.stamp_now() != self.stamp

    def windows(self) -> Iterator[Part]:
        """The same rows, in their order, WINDOW at a time where the format lets them be read so. Raises UsageError for
        a damaged file."""
        import polars as pl

        if not self.sliced:
            yield self
            return
        many = self.many
        if many is None:
            with readable(Path(self.name).suffix):
                many = int(self.open().select(pl.len()).collect().item())
        for start in range(0, max(many, 1), WINDOW):
            yield replace(self, first=self.first + start, many=min(WINDOW, many - start))

    def rows(self, columns: Columns) -> pl.LazyFrame:
        """Its rows with the columns of this module: axis and type as text, time [s] and the others as float64. Raises
        UsageError where a column is not there, or is nothing that can be read as numbers."""
        import polars as pl

        with readable(Path(self.name).suffix or "frame"):
            frame = self.open()
            schema = frame.collect_schema()
        if self.many is not None:
            frame = frame.slice(self.first, self.many)
        made = []
        for own, name in columns.named.items():
            if name in schema:
                made.append(_cast(own, name, schema[name], columns.factor))
            elif name in self.constants:
                made.append(_cast(own, name, pl.String(), columns.factor, pl.lit(self.constants[name])))
            else:
                known = [*schema, *self.constants]
                listed = ", ".join(known[:_LISTED]) + (", ..." if len(known) > _LISTED else "")
                raise UsageError(f"there is no column {name!r}; it has {listed}{did_you_mean(name, known)}")
        return frame.select(made)

    def other_types(self, columns: Columns) -> list[str]:
        """What is written as text and should be a number, or as numbers that are too short, for people."""
        import polars as pl

        schema = self.open().collect_schema()
        texts = [name for name in (columns.time, columns.input, columns.output) if schema.get(name) == pl.String]
        notes = [
            f"{name} is text, read as numbers{_DATES * (name == columns.time)}: what is none is missing"
            for name in texts
        ]
        if schema.get(columns.time) == pl.Float32:
            notes.append(f"{columns.time} has 32 bits, of a date {too_coarse(EPOCHS[0]):.0f} s: write it as float64")
        return notes


def _cast(own: str, name: str, kind: pl.DataType, factor: float, value: pl.Expr | None = None) -> pl.Expr:
    import polars as pl

    column = pl.col(name) if value is None else value
    if own in (AXIS, TYPE):
        if kind.is_nested():
            raise UsageError(f"the column {name!r} is of type {kind}, which is no name")
        return _name(column, kind).alias(own)
    if own == TIME:
        return seconds_of(column, name, kind, factor).alias(own)
    if not (kind.is_numeric() or kind == pl.String or (kind == pl.Boolean and own != OUTPUT)):
        raise UsageError(f"the column {name!r} is of type {kind}, which is no number")
    return column.cast(pl.Float64, strict=False).alias(own)


def _name(column: pl.Expr, kind: pl.DataType) -> pl.Expr:
    """Names as text; 7.0 becomes 7, because tables with missing values write integers so; an empty text is no name."""
    import polars as pl

    text = column.cast(pl.String, strict=False)
    if kind.is_float():
        whole = column.cast(pl.Int64, strict=False)
        return pl.when(column == whole).then(whole.cast(pl.String)).otherwise(text)
    return pl.when(text != "").then(text)


def is_spark(source: object) -> bool:
    """Whether it is a DataFrame of Spark, or of Spark Connect."""
    import narwhals.stable.v2.dependencies as known

    return bool(known.is_pyspark_dataframe(source) or known.is_pyspark_connect_dataframe(source))


def parts_of(source: object, out: Path | None = None) -> list[Part]:
    """The parts of a file, of a folder with files in folders, or of a frame of pandas, Polars or Arrow, lazy or not.
    out: a folder whose files are results, where it lies in the other.

    Raises UsageError for what is none of these, and for a folder without a file that can be read.
    """
    import polars as pl

    if isinstance(source, str | Path):
        return _files(Path(source), out)
    if isinstance(source, pl.LazyFrame):
        lazy = source
        return [Part(FRAME, "", lambda: lazy)]
    whole = pl.DataFrame(dict(table_of(source)))
    return [Part(FRAME, "", whole.lazy)]


def _files(source: Path, out: Path | None) -> list[Part]:
    if not source.exists():
        raise UsageError(f"{source}: there is no such file or folder; give that of the data set")
    if source.is_file():
        return [_part(source, source.parent)]
    if is_delta(source):
        return [_part(path, source, said) for path, said in delta_files(source)]
    folders, paths, closed = walk_folder(source)
    check_no_table(folders)
    known = {*READERS, *ENDINGS}
    own = None if out is None else out.resolve()
    data = (
        path for path in paths if path.suffix.lower() in known and (own is None or own not in path.resolve().parents)
    )
    found = sorted(path for path in data if not _is_hidden(path.relative_to(source)))
    if not found and not closed:
        raise UsageError(f"{source}: no file of a known format is in it; it should hold Parquet or Arrow files")
    return [_part(path, source) for path in (*found, *closed)]


def _is_hidden(path: Path) -> bool:
    """Is it a file that engines write in addition to the data?"""
    return any(part.startswith((".", "_")) for part in path.parts)


def _part(path: Path, root: Path, said: Mapping[str, str] | None = None) -> Part:
    """One file as a part. said: constants of all its rows, in addition to those in the names of its folders."""
    inside, stamp = path.relative_to(root), _stamp(path)
    pairs = (part.partition("=") for part in inside.parent.parts if "=" in part)
    constants = {unquote(key): "" if value == _NOTHING else unquote(value) for key, _, value in pairs}
    there = path.absolute()  # of an executor that works elsewhere
    name = inside.as_posix().encode("utf-8", "backslashreplace").decode()  # a file may be named by any bytes
    said = constants | dict(said or {})
    sliced = _kind(there) == ".parquet"
    return Part(name, stamp, lambda: _open_file(there), said, lambda: _stamp(there), sliced)


def _kind(path: Path) -> str:
    return ENDINGS.get(path.suffix.lower(), path.suffix.lower())


def _stamp(path: Path) -> str:
    """Empty where there is no such file any more."""
    try:
        stat = path.stat()
    except OSError:
        return ""
    return f"{stat.st_size}-{stat.st_mtime_ns}"


def _open_file(path: Path) -> pl.LazyFrame:
    import polars as pl

    if not path.exists():
        raise UsageError(f"{path} is not there for the process that reads it; all that work need it under this name")
    if "\udc80" <= max(str(path)) <= "\udcff":  # bytes that are no text
        raise UsageError("its name is not UTF-8; rename it")
    if not path.is_file():
        raise UsageError("is no file, or a folder that cannot be entered; take it out, or allow reading it")
    kind = _kind(path)
    if kind == ".parquet":
        return pl.scan_parquet(path, hive_partitioning=False, glob=False)
    if kind == ".arrow" and _begins(path, ARROW):
        return pl.scan_ipc(path, hive_partitioning=False, glob=False)
    return pl.DataFrame(dict(read_table(path))).lazy()


def _begins(path: Path, opening: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(opening)) == opening


def seconds(text: str) -> float:
    """A duration such as "10 min", "1 h", "1.5 d" or a number of seconds. Raises UsageError for anything else."""
    lengths = UNITS | {"min": 60.0, "h": 3600.0, "d": 86400.0}
    number = text.strip().rstrip("abcdefghijklmnopqrstuvwxyzµ").strip()
    unit = text.strip()[len(number) :].strip() or "s"
    try:
        found = float(number) * lengths[unit]
    except (ValueError, KeyError):
        found = float("nan")
    if not SHORTEST <= found < LONGEST:
        raise UsageError(f"{text!r} is no duration that makes a period; give one as 600, 10min, 1h or 7d")
    return found
