"""Where the estimates of a monitored run go: CSV line by line, or Parquet."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Protocol

from pmfid.errors import UsageError

#: Rows of a part of a Parquet file.
PART = 50_000

Row = tuple[float | int | str, ...]


class Sink(Protocol):
    """Takes rows; after `close` all of them are in the file."""

    def write(self, row: Row) -> None: ...

    def close(self) -> None: ...


class Nowhere:
    """No estimates are wanted."""

    def write(self, row: Row) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


class CsvSink:
    """Each row is in the file, or the pipe, when `write` returns."""

    def __init__(self, file: IO[str], header: Sequence[str]) -> None:
        self._file = file
        self._put(",".join(header))

    def write(self, row: Row) -> None:
        """A line; numbers with 9 digits."""
        self._put(",".join(f"{cell:.9g}" if isinstance(cell, float) else str(cell) for cell in row))

    def _put(self, line: str) -> None:
        self._file.write(line + "\n")
        self._file.flush()

    def close(self) -> None:
        """Closes the file, but not standard output."""
        if self._file is not sys.stdout:
            self._file.close()


class ParquetSink:
    """Rows go to parts beside the file, which `close` joins: memory stays small, and whoever is killed without notice
    finds all but the last PART rows in the parts."""

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        self._path, self._header = path, list(header)
        self._rows: list[Row] = []
        self._parts: list[Path] = []
        path.write_bytes(b"")  # a place that cannot be written to is told at once

    def write(self, row: Row) -> None:
        """A row."""
        self._rows.append(row)
        if len(self._rows) >= PART:
            self._flush()

    def _flush(self) -> None:
        part = self._path.with_name(f"{self._path.name}.part{len(self._parts):05d}")
        self._frame().write_parquet(part)
        self._parts.append(part)
        self._rows = []

    def _frame(self) -> Any:
        import polars as pl

        columns: list[Sequence[Any]] = list(zip(*self._rows, strict=True)) if self._rows else [[] for _ in self._header]
        kinds = {"status": pl.UInt32, "state": pl.String}
        series = zip(self._header, columns, strict=True)
        return pl.DataFrame([pl.Series(name, values, kinds.get(name, pl.Float64)) for name, values in series])

    def close(self) -> None:
        """Joins the parts."""
        import polars as pl

        if not self._parts:
            self._frame().write_parquet(self._path)
            return
        if self._rows:
            self._flush()
        pl.scan_parquet(self._parts, glob=False).sink_parquet(self._path)
        for part in self._parts:
            part.unlink()


def open_sink(out: Path | None, header: Sequence[str]) -> Sink:
    """The sink for a path; "-": CSV on standard output. Raises UsageError for another kind of file."""
    if out is None:
        return Nowhere()
    if str(out) == "-":
        return CsvSink(sys.stdout, header)
    kind = out.suffix.lower()
    if kind == ".csv":
        return CsvSink(out.open("w", encoding="utf-8", newline="\n"), header)
    if kind == ".parquet":
        return ParquetSink(out, header)
    raise UsageError(f"estimates go to a .csv or .parquet file, got {out.name!r}; - is standard output")
