"""Tables, which are columns by name from files, frames and arrays, and their clocks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, did_you_mean
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl

#: Column of stamps [s].
TIME: Final = "time"
#: Largest difference of stamps within one cycle of a task, relative to the cycle.
CYCLE = 0.5


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal with its stamps (n,) [s] and values (n,)."""

    time: Floats
    values: NDArray[np.generic]


class ClockedSignals(Mapping[str, object]):
    """Signals by name, on the clock of a base signal. The column `TIME` has the stamps of that clock.

    If a signal has exactly one value in each cycle of the clock, its values are taken cycle by cycle. Any other signal
    holds its last value.
    """

    def __init__(self, signals: Mapping[str, Signal], base: str = "", others: tuple[str, ...] = ()) -> None:
        """Make the table, where `base` is the signal with the clock, by default the longest signal.

        The table starts after the first values of the signals `others`.
        """
        self._signals = signals
        usual = max(signals, key=lambda name: signals[name].time.size, default="")
        stamps = signals[base if base in signals else usual].time if signals else np.empty(0)
        starts = [signals[name].time[0] for name in others if name in signals and signals[name].time.size]
        self._from = int(np.searchsorted(stamps, max(starts, default=-np.inf) - CYCLE * _period(stamps)))
        self._stamps, self._held = stamps, dict[str, None]()

    def align(self, base: str, others: tuple[str, ...]) -> ClockedSignals:
        """Return the signals on the clock of `base`, from the first stamp at which all signals in `others` have
        begun.
        """
        return ClockedSignals(self._signals, base, others)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the requested columns that hold their last value."""
        return tuple(
            f"{name} has its own time stamps: at each stamp of the output, the last value of {name} counts"
            for name in self._held
        )

    def __getitem__(self, name: str) -> object:
        if name == TIME and name not in self._signals:
            return self._stamps[self._from :]
        return self._sample(name, self._signals[name])[self._from :]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((TIME, *self._signals)))

    def __len__(self) -> int:
        return len(set(self._signals) | {TIME})

    def _sample(self, name: str, signal: Signal) -> NDArray[np.generic]:
        """Return the values of a signal at the stamps."""
        stamps, time = self._stamps, signal.time
        if time.size == stamps.size and np.all(np.abs(time - stamps) <= CYCLE * _period(stamps)):
            return signal.values
        self._held[name] = None
        last = np.searchsorted(time, stamps, side="right") - 1
        if not time.size:
            return np.full(stamps.size, np.nan)
        return np.where(last < 0, np.nan, np.asarray(signal.values, np.float64)[np.maximum(last, 0)])


def _period(stamps: Floats) -> float:
    return float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0


class ArrowFrame(Protocol):
    """A frame of Polars or Arrow, or a recent frame of pandas."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object: ...


class PandasFrame(Protocol):
    """A frame of pandas."""

    @property
    def iloc(self) -> object: ...


#: A record in memory: a frame, or arrays by name.
Frame = Mapping[str, ArrayLike] | ArrowFrame | PandasFrame
#: Columns by name, each an array or a polars series, according to the reader of the file.
Table = Mapping[str, object]

#: Remedies for a cell that is not a number.
NUMBERS = "write numbers like 0.25, remove lines that are not data, or name another column"
DATES = "write seconds like 0.25, 2026-03-04 12:00:00.25 or 12:00:00.25, and remove lines that are not data"
#: The beginning of a text with a date, and the possible forms of the date, the most usual first.
DATE_FORMS = {
    r"\d{4}-": ("%Y-%m-%d",),
    r"\d{4}/": ("%Y/%m/%d",),
    r"\d{1,2}\.": ("%d.%m.%Y",),
    r"\d{1,2}-": ("%d-%m-%Y",),
    r"\d{1,2}/": ("%m/%d/%Y", "%d/%m/%Y"),
}
#: Length of a day [s].
DAY = 86_400.0
#: A unit in brackets at the end of a name.
_UNIT = re.compile(r"\s*[\[(][^\])]*[\])]$")


class NotedTable(dict[str, object]):
    """A table with notes for people on the reading of the file."""

    def __init__(self, columns: Mapping[str, object], notes: tuple[str, ...]) -> None:
        super().__init__(columns)
        self.notes = notes


def notes_of(table: Table) -> tuple[str, ...]:
    """Return the notes on the reading of a table, or an empty tuple for a plain table."""
    return table.notes if isinstance(table, NotedTable | ClockedSignals) else ()


def whole_name(table: Table, name: str) -> str:
    """Return the full name of a column, because the file may add a unit in brackets or a unique path.

    Examples of full names are "t [ms]" and "/run.t" for the column "t".
    """
    if name in table:
        return name
    plain = {full: _UNIT.sub("", full) for full in table}
    for found in (
        [full for full, called in plain.items() if called == name],
        [full for full, called in plain.items() if called.endswith(f".{name}")],
    ):
        if found:
            return found[0] if len(found) == 1 else name
    return name


#: Largest number of bytes in a cell of text. A number or a time needs a tenth of the limit.
LONGEST_CELL = 1000
#: Suffix that polars adds to the name of a second column with an equal name.
TWICE = "_duplicated_0"


def lookup(table: Table, key: str, name: str) -> object:
    """Return the column `name`, which [record] `key` asks for. Raises UsageError with a list of the columns."""
    if f"{name}{TWICE}" in table:
        raise UsageError(f"[record] {key} = {name!r}: two columns have this name; rename one of them")
    if name in table:
        return table[name]
    listed = ", ".join(list(table)[:30]) or "none"
    hint = did_you_mean(name, table)
    raise UsageError(f"[record] {key} = {name!r}: there is no such column; available are {listed}{hint}")


def _check_cells(label: str, series: pl.Series) -> None:
    """Raise UsageError for texts that are too long for a number or a time.

    A packed file may repeat a long text in every row.
    """
    import polars as pl

    if series.dtype == pl.String and (longest := cast("int", series.str.len_bytes().max() or 0)) > LONGEST_CELL:
        raise UsageError(
            f"{label} has a text of {longest} bytes, more than {LONGEST_CELL}, so it is neither a number nor a time; "
            "name a column of numbers"
        )


def column(table: Table, key: str, name: str) -> Floats:
    """Return the column `name` as numbers (n,) with NaN for empty cells. Raises UsageError if the column is not
    numeric.
    """
    value = lookup(table, key, name)
    label = f"{key} column {name!r}"
    if isinstance(value, np.ndarray):
        return from_array(label, value).ravel()
    return _from_series(label, cast("pl.Series", value))


def times(table: Table, name: str) -> tuple[Floats, bool]:
    """Return the time column `name` as numbers (n,), and whether it has dates or times of day.

    Dates and times of day give seconds since the first row. Whole numbers are also relative to the first row, in their
    own unit, because an epoch in ns has more digits than a float. Raises UsageError as `column` does.
    """
    value, label = lookup(table, "time", name), f"time column {name!r}"
    if isinstance(value, np.ndarray):
        return from_array(label, value).ravel(), False
    return _read_clock(label, cast("pl.Series", value))


def _read_clock(label: str, series: pl.Series) -> tuple[Floats, bool]:
    import polars as pl

    _check_cells(label, series)
    if series.dtype == pl.String and not _has_number(series):
        series = _parse_times(series)
    daily = series.dtype if series.dtype == pl.Time else None
    if daily is not None:
        series = series.cast(pl.Duration("ns"))
    if series.dtype.is_temporal() and series.dtype != pl.Date:
        ns = series.dt.timestamp("ns") if series.dtype != pl.Duration else series.cast(pl.Duration("ns")).cast(pl.Int64)
        since = ns - (ns.drop_nulls().first() or 0)
        seconds = since.cast(pl.Float64).fill_null(np.nan).to_numpy() * 1e-9
        return np.asarray(seconds if daily is None else _past_midnight(seconds)), True
    return _from_series(label, series, DATES), False


def _past_midnight(seconds: Floats) -> Floats:
    """Return times of day (n,) that continue after midnight."""
    back = np.nan_to_num(np.diff(seconds, prepend=seconds[:1])) < -DAY / 2
    return seconds + DAY * np.cumsum(back)


def _has_number(series: pl.Series) -> bool:
    import polars as pl

    return not series.str.strip_chars().cast(pl.Float64, strict=False).is_null().all()


def _parse_times(series: pl.Series) -> pl.Series:
    """Parse dates with times, or times of day. Any other text remains unchanged.

    Of 3/4/2026, the month is the first number, unless some row has a larger first number than 12.
    """
    import polars as pl

    plain = series.str.strip_chars().str.replace("T", " ", literal=True).str.replace(",", ".", literal=True)
    plain = plain.str.replace(r"(Z|[+-]\d\d:?\d\d)$", "")
    first = str(plain.drop_nulls().first())
    clock = "%I:%M:%S%.f %p" if first[-1:] in "mM" else "%H:%M:%S%.f"
    dates = [form for shape, forms in DATE_FORMS.items() if re.match(shape, first) for form in forms]
    kind = pl.Datetime("ns") if dates else pl.Time()
    parsed = [plain.str.strptime(kind, f"{date} {clock}".strip(), strict=False) for date in dates or [""]]
    best = min(parsed, key=lambda times: times.null_count())
    return series if best.is_null().all() else best


def from_array(label: str, array: NDArray[np.generic]) -> Floats:
    """Return an array as float64 in its own shape. Raises UsageError, with the label, unless it is a real vector."""
    if array.dtype.kind not in "biuf":
        raise UsageError(f"{label} is not a real numeric array but {array.dtype}; save it as a vector of double")
    if array.size > 1 and max(array.shape) != array.size:
        raise UsageError(
            f"{label} has the shape {array.shape} and is not a vector; save one column as its own variable"
        )
    return array.astype(np.float64)


def _from_series(label: str, series: pl.Series, remedy: str = NUMBERS) -> Floats:
    import polars as pl

    _check_cells(label, series)
    if series.dtype == pl.String:
        parsed = series.str.strip_chars().cast(pl.Float64, strict=False)
        bad = (parsed.is_null() & series.is_not_null()).arg_true()
        if len(bad):
            raise UsageError(f"{label} is not numeric: {series[bad[0]][:60]!r} in row {bad[0] + 1}; {remedy}")
        series = parsed
    if not series.dtype.is_numeric() and series.dtype != pl.Null:
        raise UsageError(f"{label} is not numeric but {series.dtype}; store it as numbers (time in s)")
    numbers = series if series.dtype == pl.Float64 else series.cast(pl.Float64)
    values: Floats = (numbers.fill_null(np.nan) if numbers.null_count() else numbers).to_numpy()
    return values


def table_of(frame: object) -> Table:
    """Return the columns of a frame, or of a dict of arrays. Raises UsageError for any other object."""
    if isinstance(frame, Mapping):
        return {str(name): np.asarray(values) for name, values in frame.items()}
    import polars as pl

    if hasattr(frame, "iloc"):  # the frame comes from pandas or a similar library
        pandas = cast("Any", frame)
        return {str(name): _from_pandas(str(name), pandas[name]) for name in pandas.columns}
    if not hasattr(frame, "__arrow_c_stream__"):
        raise UsageError(
            "a record must be a frame of pandas, Polars or Arrow, a dict of arrays or the path of a file, got "
            f"{type(frame).__name__}; collect a lazy frame first"
        )
    return {column.name: column for column in pl.DataFrame(frame).iter_columns()}


def _from_pandas(name: str, series: Any) -> pl.Series:
    """Return a column in the form of a file's columns, which keeps whole numbers, dates and missing values."""
    import polars as pl

    kind = getattr(series.dtype, "kind", "O")
    if getattr(series.dtype, "tz", None):
        series = series.dt.tz_convert("UTC").dt.tz_localize(None)
    if kind in "iuf":
        missing = series.isna().any()
        return pl.Series(name, series.to_numpy(np.float64, na_value=np.nan) if missing else series.to_numpy())
    return pl.Series(name, series.to_numpy()) if kind in "mM" else pl.Series(name, series.to_list(), strict=False)
