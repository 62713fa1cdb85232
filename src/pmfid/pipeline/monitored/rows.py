"""Files for the estimates of a monitored run: CSV line by line, or Parquet, which is made of such lines at the end."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Protocol

from pmfid.errors import UsageError
from pmfid.io.row_file import RowFile, Tell, fresh, is_stream

Row = tuple[float | int | str, ...]


class RowSink(Protocol):
    """Takes rows; after `close` all of them are in the file. path: of the file, None without one; lost: rows that could
    not be written."""

    @property
    def path(self) -> Path | None: ...

    @property
    def lost(self) -> int: ...

    def write(self, row: Row) -> None: ...

    def close(self) -> None: ...


class Nowhere:
    """No estimates are wanted."""

    path: Path | None = None
    lost = 0

    def write(self, row: Row) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


class StreamSink:
    """Each row is in the pipe when `write` returns."""

    path: Path | None = None
    lost = 0

    def __init__(self, stream: IO[str], header: Sequence[str]) -> None:
        self._stream = stream
        self._put(",".join(header))

    def write(self, row: Row) -> None:
        """A line; numbers with 9 digits."""
        self._put(_short(row))

    def _put(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()

    def close(self) -> None:
        """The stream stays open."""


class CsvSink:
    """Each row is in the file when `write` returns."""

    def __init__(self, path: Path, header: Sequence[str], tell: Tell) -> None:
        self._file = RowFile(path, tell)
        self.path = path
        self._file.put(",".join(header))

    @property
    def lost(self) -> int:
        return self._file.lost

    def write(self, row: Row) -> None:
        """A line; numbers with 9 digits."""
        self._file.put(_short(row))

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class ParquetSink:
    """Rows go to a CSV file in the same folder, and `close` converts it to Parquet. Memory stays small, and a process
    that is killed loses no row."""

    def __init__(self, path: Path, header: Sequence[str], tell: Tell) -> None:
        self.path = path
        self._target, self._header, self._tell = path, list(header), tell
        self._rows = RowFile(rows_path(path), tell)
        self._rows.put(",".join(header))

    @property
    def lost(self) -> int:
        return self._rows.lost

    def write(self, row: Row) -> None:
        """A row, with all digits."""
        self._rows.put(",".join(map(str, row)))

    def close(self) -> None:
        """Makes the Parquet file; if that fails, the rows stay, and `tell` gets the error."""
        import polars as pl

        self._rows.close()
        part = self._target.with_name(f"{self._target.name}.part")
        kinds = {"status": pl.UInt32, "state": pl.String}
        schema = {name: kinds.get(name, pl.Float64) for name in self._header}
        try:
            pl.scan_csv(self._rows.path, schema=schema, glob=False).sink_parquet(part)
            os.replace(part, fresh(self._target))
        except (OSError, pl.exceptions.PolarsError) as error:
            part.unlink(missing_ok=True)
            problem = f"{' '.join(str(error).split())}; the rows are in {self._rows.path}"
            self._tell({"event": "write error", "file": str(self._target), "problem": problem})
            return
        self._rows.path.unlink()


def rows_path(path: Path) -> Path:
    """The CSV file with the rows of an unfinished Parquet file."""
    return path.with_name(f"{path.name}.csv")


def _short(row: Row) -> str:
    return ",".join(f"{cell:.9g}" if isinstance(cell, float) else str(cell) for cell in row)


def open_sink(out: Path | None, header: Sequence[str], tell: Tell) -> RowSink:
    """The sink for a path; "-": CSV on standard output. An existing file stays: the rows go to path-2 and so on.

    Raises UsageError for another kind of file.
    """
    if out is None:
        return Nowhere()
    if str(out) == "-":
        return StreamSink(sys.stdout, header)
    kind = out.suffix.lower()
    if kind not in (".csv", ".parquet"):
        raise UsageError(f"estimates go to a .csv or .parquet file, got {out.name!r}; - is standard output")
    while True:
        try:
            if kind == ".csv":
                return CsvSink(out if is_stream(out) else fresh(out), header, tell)
            return ParquetSink(fresh(out, rows_path), header, tell)
        except FileExistsError:  # another monitor took that name just now
            continue
