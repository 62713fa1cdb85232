"""Files for the estimates of a monitored run, as CSV or as Parquet."""

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
    """A sink for rows, which are all in the file after `close`.

    `path` is the path of the file, or None without a file. `lost` is the number of rows that could not be written.
    """

    @property
    def path(self) -> Path | None: ...

    @property
    def lost(self) -> int: ...

    def write(self, row: Row) -> None: ...

    def close(self) -> None: ...


class Nowhere:
    """A sink that drops all rows."""

    path: Path | None = None
    lost = 0

    def write(self, row: Row) -> None:
        """Drop a row."""

    def close(self) -> None:
        """Do nothing."""


class StreamSink:
    """A sink whose rows are in the pipe when `write` returns."""

    path: Path | None = None
    lost = 0

    def __init__(self, stream: IO[str], header: Sequence[str]) -> None:
        self._stream = stream
        self._put(",".join(header))

    def write(self, row: Row) -> None:
        """Write a line with 9 digits per number."""
        self._put(_short(row))

    def _put(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Leave the stream open."""


class CsvSink:
    """A sink whose rows are in the CSV file when `write` returns."""

    def __init__(self, path: Path, header: Sequence[str], tell: Tell) -> None:
        self._file = RowFile(path, tell)
        self.path = path
        self._file.put(",".join(header))

    @property
    def lost(self) -> int:
        return self._file.lost

    def write(self, row: Row) -> None:
        """Write a line with 9 digits per number."""
        self._file.put(_short(row))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class ParquetSink:
    """A sink that writes rows to a CSV file in the same folder, and converts it to Parquet in `close`.

    The memory stays small, and a killed process loses no row.
    """

    def __init__(self, path: Path, header: Sequence[str], tell: Tell) -> None:
        self.path = path
        self._target, self._header, self._tell = path, list(header), tell
        self._rows = RowFile(rows_path(path), tell)
        self._rows.put(",".join(header))

    @property
    def lost(self) -> int:
        return self._rows.lost

    def write(self, row: Row) -> None:
        """Write a row with all digits."""
        self._rows.put(",".join(map(str, row)))

    def close(self) -> None:
        """Make the Parquet file. After a failure, the rows remain in the CSV file and `tell` gets the error."""
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
    """Return the CSV file with the rows of an unfinished Parquet file."""
    return path.with_name(f"{path.name}.csv")


def _short(row: Row) -> str:
    return ",".join(f"{cell:.9g}" if isinstance(cell, float) else str(cell) for cell in row)


def open_sink(out: Path | None, header: Sequence[str], tell: Tell) -> RowSink:
    """Open the sink for a path, where "-" means CSV on standard output.

    If the file exists, the rows go to path-2, path-3 and so on.

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
        except FileExistsError:  # another monitor has just taken the name
            continue
