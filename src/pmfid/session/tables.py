"""Tables: the columns of a CSV, Parquet or MATLAB file by name, and one column as numbers."""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError, did_you_mean
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Table", "column", "from_array", "lookup", "read_table"]

#: Column by name: a polars series from a CSV or Parquet file, an array from a .mat file.
Table = Mapping[str, object]

#: Polars' end of the name of a column that is there already.
_TWICE = "_duplicated_0"
#: Values that a file may unpack to, in bytes: so many times its own size, or this many; more is a bomb or a mistake.
_MOST_TIMES, _MOST_BYTES = 20, 2**28
#: How gzip, zlib, zstd and bzip2 begin.
_PACKED = (b"\x1f\x8b", b"x\x01", b"x\x9c", b"x\xda", b"\x28\xb5\x2f\xfd", b"BZh9")
_MISSING = ["", "NA", "N/A", "null", "NULL", "None"]
# Types of the elements of a MATLAB v5 file ("MAT-File Format", MathWorks, table 1-1); the others are reserved.
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
_NUMERIC = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}
_CHAR_CLASS, _SPARSE_CLASS, _LAST_NUMERIC_CLASS, _COMPLEX = 4, 5, 15, 0x800


def read_table(path: Path) -> Table:
    """All columns of a .csv, .parquet or .mat (v5) file, not yet converted.

    Raises UsageError with the remedy for a file that is missing, empty, truncated, corrupt or of another type.
    """
    parsers: dict[str, Callable[[bytes], Table]] = {".csv": _parse_csv, ".parquet": _ParquetTable, ".mat": _parse_mat}
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the record: {error.strerror}; give the path of a data file") from None
    parse = parsers.get(path.suffix.lower())
    if parse is None:
        raise UsageError(f"file type {path.suffix!r} is not known; use one of {', '.join(parsers)}")
    if not data.strip():
        raise UsageError("the file is empty; export the record again")
    with _readable(path.suffix.lower()):
        return parse(data)


@contextmanager
def _readable(kind: str) -> Iterator[None]:
    """Turns whatever a reader stumbles over into a UsageError: OSError, ValueError, zlib.error, and polars' Rust core a
    PanicException that is no Exception. Only what ends the program passes through."""
    try:
        yield
    except UsageError:
        raise
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit, GeneratorExit)):
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise UsageError(f"not a readable {kind} file, truncated or corrupt ({reason}); export it again") from None


def lookup(table: Table, key: str, name: str) -> object:
    """The column `name`, which [record] `key` asks for; raises UsageError listing what there is."""
    if f"{name}{_TWICE}" in table:
        raise UsageError(f"[record] {key} = {name!r}: two columns have this name; rename one of them")
    if name in table:
        return table[name]
    listed = ", ".join(list(table)[:30]) or "none"
    hint = did_you_mean(name, table)
    raise UsageError(f"[record] {key} = {name!r}: there is no such column; available are {listed}{hint}")


def column(table: Table, key: str, name: str) -> Floats:
    """The column `name` as (n,) numbers, NaN where a cell is empty; raises UsageError where it is not numeric."""
    value = lookup(table, key, name)
    label = f"{key} column {name!r}"
    if isinstance(value, np.ndarray):
        return from_array(label, value).ravel()
    return _from_series(label, cast("pl.Series", value))


def from_array(label: str, array: NDArray[np.generic]) -> Floats:
    """An array as float64 in its own shape; raises UsageError, with the label, unless it is a real vector."""
    if array.dtype.kind not in "biuf":
        raise UsageError(f"{label} is not a real numeric array but {array.dtype}; save it as a vector of double")
    if array.size > 1 and max(array.shape) != array.size:
        raise UsageError(f"{label} is not a vector, its shape is {array.shape}; save one column as its own variable")
    return array.astype(np.float64)


def _from_series(label: str, series: pl.Series) -> Floats:
    import polars as pl

    if series.dtype == pl.String:
        numbers = series.str.strip_chars().cast(pl.Float64, strict=False)
        bad = (numbers.is_null() & series.is_not_null()).arg_true()
        if len(bad):
            raise UsageError(f"{label} is not numeric: {series[bad[0]]!r} in row {bad[0] + 1}; write numbers like 0.25")
        series = numbers
    if not series.dtype.is_numeric():
        raise UsageError(f"{label} is not numeric but {series.dtype}; store it as numbers (time in s)")
    values: Floats = series.cast(pl.Float64).fill_null(np.nan).to_numpy()
    return values


def _parse_csv(data: bytes) -> Table:
    import polars as pl

    if data.startswith(_PACKED):  # polars would unpack it, however large
        raise UsageError("a packed file; unpack it first, and mind how large it becomes")
    if b"\0" in data:
        raise UsageError("not a text file; use the ending that tells its type, or export it as UTF-8 CSV")
    header = data.lstrip().splitlines()[0]
    if b"," not in header and (b";" in header or b"\t" in header):
        raise UsageError("the columns are not separated by commas; export with comma separators and decimal points")
    # All as text first: a column is converted, and complained about, only if it is used.
    frame = pl.read_csv(data, infer_schema=False, null_values=_MISSING)
    table: dict[str, object] = {}
    for column in frame.columns:
        name = column.strip()
        table[f"{name}{_TWICE}" if name in table else name] = frame[column]
    return table


class _ParquetTable(Mapping[str, object]):
    """The columns of a Parquet file, each read when it is asked for."""

    def __init__(self, data: bytes) -> None:
        import polars as pl

        self._data, self._names = data, list(pl.read_parquet_schema(io.BytesIO(data)))
        rows = int(pl.scan_parquet(io.BytesIO(data)).select(pl.len()).collect().item())
        _check_unpacked(8 * rows, len(data), "a column")

    def __getitem__(self, name: str) -> object:
        import polars as pl

        if name not in self._names:
            raise KeyError(name)
        with _readable(".parquet"):
            return pl.read_parquet(io.BytesIO(self._data), columns=[name])[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _check_unpacked(size: int, packed: int, what: str) -> None:
    """Raises UsageError before so many bytes are taken from so few."""
    if size > max(_MOST_BYTES, _MOST_TIMES * packed):
        raise UsageError(
            f"{what} takes {size / 1e6:.0f} MB or more out of a file of {packed / 1e6:.2g} MB; decimate or cut the "
            "record"
        )


def _parse_mat(data: bytes) -> Table:
    import scipy.io

    remedy = "a MATLAB v7.3 file is not read; save it in MATLAB with save(name, '-v7')"
    if data.startswith(b"\x89HDF"):
        raise UsageError(remedy)
    _check_mat(data)
    try:
        with warnings.catch_warnings(action="error", category=scipy.io.matlab.MatReadWarning):
            variables = scipy.io.loadmat(io.BytesIO(data))
    except NotImplementedError:
        raise UsageError(remedy) from None
    named = {name: value for name, value in variables.items() if not name.startswith("__")}
    # a sparse matrix, or another class, is no column, and says so when it is asked for
    return {name: value if isinstance(value, np.ndarray) else np.empty(0, object) for name, value in named.items()}


def _check_mat(data: bytes) -> None:
    """Raises ValueError unless all sizes and types in a v5 file fit: on others scipy's reader ends the whole process.

    A file of another version passes; the reader is left to say so.
    """
    order = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(data[124:128])
    if order is None or 0 in data[:4]:
        return
    left = max(_MOST_BYTES, _MOST_TIMES * len(data))
    for kind, body in _elements(memoryview(data)[128:], order, padding=1):
        if kind == _COMPRESSED:
            inner = _unpacked(body, left, len(data))
            left -= len(inner)
            ((kind, body),) = _elements(inner, order, padding=1)
        if kind != _MATRIX:
            raise ValueError(f"element of type {kind} in place of a variable")
        _check_matrix(body, order)


def _unpacked(body: memoryview, most: int, packed: int) -> memoryview:
    """A compressed element, of at most so many bytes; raises UsageError before more are taken."""
    stream = zlib.decompressobj()
    inner = stream.decompress(body, most + 1)
    if len(inner) > most:
        _check_unpacked(max(_MOST_BYTES, _MOST_TIMES * packed) + 1, packed, "a variable")
    if not stream.eof:
        raise ValueError("a compressed variable is cut off")
    return memoryview(inner)


def _elements(data: memoryview, order: str, padding: int = 8) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element; `order`: "<" or ">", `padding`: multiple of bytes that an element takes."""
    word = np.dtype(f"{order}u4")
    start = 0
    while start < len(data):
        if len(data) - start < 8:
            raise ValueError("an element without its size")
        kind, size = (int(number) for number in np.frombuffer(data, word, 2, start))
        first, step = start + 8, -(-size // padding) * padding
        if kind >> 16:  # four bytes at most are stored in the place of the size
            kind, size, first, step = kind & 0xFFFF, kind >> 16, start + 4, 4
        if size > min(step, len(data) - first):
            raise ValueError("an element is longer than the file")
        yield kind, data[first : first + size]
        start = first + step


def _check_matrix(body: memoryview, order: str) -> None:
    parts = list(_elements(body, order))
    if not parts:  # an empty cell
        return
    kinds, sizes = [kind for kind, _ in parts], [len(part) for _, part in parts]
    if not (kinds[0] == _UINT32 and sizes[0] == 8):
        raise ValueError("a variable without its class")
    flags = int(np.frombuffer(parts[0][1], f"{order}u4", 1)[0])
    if flags & 0xFF <= _LAST_NUMERIC_CLASS:
        _check_array(kinds, sizes, flags)
    for kind, part in parts:
        if kind == _MATRIX:
            _check_matrix(part, order)
        elif kind not in _NUMERIC:
            raise ValueError(f"element of unknown type {kind}")


def _check_array(kinds: list[int], sizes: list[int], flags: int) -> None:
    """Every array starts with flags, dimensions and name; values follow, in a sparse one after two rows of indices."""
    indices = 2 if flags & 0xFF == _SPARSE_CLASS else 0
    values = 2 if flags & _COMPLEX else 1
    nested = flags & 0xFF < _CHAR_CLASS
    if len(kinds) < (3 if nested else 3 + indices + values):
        raise ValueError("a variable without its dimensions, name or values")
    if kinds[1] not in (_INT32, _UINT32) or sizes[1] < 8 or kinds[2] not in (_INT8, _UTF8):
        raise ValueError("a variable with a wrong dimension or name")
    if not nested and _MATRIX in kinds:
        raise ValueError("a variable in place of values")
