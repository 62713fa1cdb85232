"""Records as files: columns with defects, in every format, whole and damaged."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse

from tests import formats
from tests.formats import frame
from tests.hostile.plants import Columns

Rng = np.random.Generator

#: Share of the records with a defect, and of these the share with a further defect.
DEFECT = 0.35
#: Compressions of a file whose name does not show them.
PACKERS: list[Callable[[bytes], bytes]] = [gzip.compress, zlib.compress, bz2.compress]


def _numbers(values: Any) -> np.ndarray:
    """Return a column as floats, or zeros if the column has become text."""
    array = np.asarray(values)
    return array.astype(float) if array.dtype.kind in "biuf" else np.zeros(array.size)


def _spoilt(rng: Rng, columns: Columns) -> Columns:
    """Return columns with some unexpected values in one column."""
    name = str(rng.choice(list(columns)))
    values = _numbers(columns[name]).copy()
    bad = rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 1e-320, 2.0**63, 1e18, 0.5])
    values[rng.integers(values.size, size=int(rng.choice([1, 3, values.size])))] = bad
    return columns | {name: values}


def _scaled(rng: Rng, columns: Columns) -> Columns:
    name = str(rng.choice(list(columns)))
    factor = float(rng.choice([0.0, -1.0, 1e3, 1e6, 1e9, 1e-9, 1e-200, 1e200, 1e120]))
    return columns | {name: _numbers(columns[name]) * factor}


def _exchanged(rng: Rng, columns: Columns) -> Columns:
    one, other = rng.choice(list(columns), 2, replace=False)
    return columns | {str(one): columns[other], str(other): columns[one]}


def _without(rng: Rng, columns: Columns) -> Columns:
    gone = str(rng.choice(list(columns)))
    return {name: values for name, values in columns.items() if name != gone}


def _renamed(rng: Rng, columns: Columns) -> Columns:
    old = str(rng.choice(list(columns)))
    new = str(rng.choice(["T", " u", "y [mm]", "t_ms", "time [s]", "\x1b[31mred", "größe", "[bold]u", "a\x07b", "1"]))
    return {new if name == old else name: values for name, values in columns.items()}


def _cut(rng: Rng, columns: Columns) -> Columns:
    """Return columns with rows left out, repeated, in another order, or nearly all removed."""
    n = len(next(iter(columns.values())))
    rows = np.arange(n)
    way = rng.integers(6)
    if way == 0:
        rows = rows[: rng.integers(0, 30)]
    elif way == 1:
        rows = np.delete(rows, rng.integers(n, size=max(1, n // 100)))
    elif way == 2:
        rows = np.sort(np.r_[rows, rng.integers(n, size=3)])
    elif way == 3:
        rows = rows[::-1]
    elif way == 4:
        rows = np.delete(rows, slice(n // 2, n // 2 + 50))
    else:
        rows = rows[:: int(rng.integers(2, 40))]
    return {name: np.asarray(values)[rows] for name, values in columns.items()}


def _wrapped(rng: Rng, columns: Columns) -> Columns:
    if "counts" not in columns:
        return columns
    with np.errstate(invalid="ignore"):
        counts = np.nan_to_num(_numbers(columns["counts"]), posinf=0, neginf=0) % 2.0 ** int(rng.choice([4, 8, 10]))
    return columns | {"counts": counts}


def _jittered(rng: Rng, columns: Columns) -> Columns:
    if "t" not in columns:
        return columns
    t = _numbers(columns["t"])
    return columns | {"t": t + rng.normal(size=t.size) * float(rng.choice([1e-5, 1e-3, 1e-2]))}


def _typed(rng: Rng, columns: Columns) -> Columns:
    name = str(rng.choice(list(columns)))
    values = np.asarray(columns[name])
    ways: list[Callable[[], Any]] = [
        lambda: [f"{value:.6g} V" for value in _numbers(values).tolist()],
        lambda: [str(value).replace(".", ",") for value in values.tolist()],
        lambda: _numbers(values) > 0.1,
        lambda: ["" for _ in values],
        lambda: [f" {value!r} " for value in values.tolist()],
    ]
    return columns | {name: ways[rng.integers(len(ways))]()}


DEFECTS: list[Callable[[Rng, Columns], Columns]] = [
    _spoilt,
    _scaled,
    _exchanged,
    _without,
    _renamed,
    _cut,
    _wrapped,
    _jittered,
    _typed,
]


def with_defects(rng: Rng, columns: Columns) -> Columns:
    """Return columns with none, one or several defects."""
    columns = dict(columns)
    while rng.random() < DEFECT:
        columns = rng.choice(DEFECTS)(rng, columns)  # type: ignore[arg-type]
    return columns


def as_csv(rng: Rng, columns: Columns) -> bytes:
    encoding = str(rng.choice(["utf-8", "utf-8-sig", "utf-16"], p=[0.9, 0.07, 0.03]))
    return frame(columns).write_csv().encode(encoding)


def as_file(rng: Rng, columns: Columns, folder: Path) -> tuple[str, bytes]:
    """Return a record as a file: name and bytes, of which some may be missing, wrong, or compressed."""
    kind = str(rng.choice(list(WRITERS), p=[part for part, _ in WRITERS.values()]))
    data = WRITERS[kind][1](rng, columns, folder)
    if rng.random() < 0.08:
        data = damaged(rng, data)
    stem = str(rng.choice(["run", "a b", "run[red]", "größe", "esc\x1b[31m"], p=[0.9, 0.03, 0.03, 0.02, 0.02]))
    ends = [kind, kind.upper(), ".csv", ".gz", ".txt"]
    return f"{stem}{rng.choice(ends, p=[0.92, 0.02, 0.03, 0.01, 0.02])}", data


def _parquet(rng: Rng, columns: Columns, folder: Path) -> bytes:
    how = str(rng.choice(["zstd", "gzip", "snappy", "uncompressed"]))
    frame(columns).write_parquet(folder / "drawn.parquet", compression=how)  # type: ignore[arg-type]
    return (folder / "drawn.parquet").read_bytes()


def _mat(rng: Rng, columns: Columns, folder: Path) -> bytes:
    named = {name: np.asarray(values) for name, values in columns.items() if name.isidentifier() and name.isascii()}
    named |= {"gain": np.float64(rng.choice([2.0, 0.0, np.nan, -1.0]))}
    if rng.random() < 0.1 and named:
        name = str(rng.choice(list(named)))
        odd: list[Any] = [np.ones((3, 4)), np.array(1j), scipy.sparse.eye(5).tocsc(), np.array([], float), {"a": 1.0}]
        named[name] = odd[rng.integers(len(odd))]
    scipy.io.savemat(folder / "drawn.mat", named, do_compression=bool(rng.random() < 0.5))
    return (folder / "drawn.mat").read_bytes()


def _as(suffix: str) -> Callable[[Rng, Columns, Path], bytes]:
    """Return a writer of files of this format, which works as other programs do."""

    def written(_: Rng, columns: Columns, folder: Path) -> bytes:
        path = folder / f"drawn{suffix}"
        path.unlink(missing_ok=True)
        formats.WRITERS[suffix](path, columns)
        return path.read_bytes()

    return written


#: Suffix -> share of the files with this suffix, and function that returns their bytes.
WRITERS: dict[str, tuple[float, Callable[[Rng, Columns, Path], bytes]]] = {
    ".csv": (0.6, lambda rng, columns, _: as_csv(rng, columns)),
    ".parquet": (0.1, _parquet),
    ".mat": (0.12, _mat),
}
REST = [suffix for suffix in formats.WRITERS if suffix not in WRITERS]
WRITERS |= {suffix: (0.18 / len(REST), _as(suffix)) for suffix in REST}


def damaged(rng: Rng, data: bytes) -> bytes:
    """Return the bytes emptied, cut off, with another separator, compressed, or with some bytes replaced."""
    way = rng.integers(6)
    if way == 0 or not data:
        return b""
    if way == 1:
        return data[: rng.integers(len(data))]
    if way == 2:
        return data.replace(b",", b";")
    if way == 3:
        return PACKERS[rng.integers(len(PACKERS))](data)
    spot = int(rng.integers(len(data)))
    return data[:spot] + bytes(rng.integers(0, 256, 4, dtype=np.uint8)) + data[spot + 4 :]
