"""Files for the estimates of a monitored run, as CSV or as Parquet."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from pmfid.errors import UsageError
from pmfid.io.row_file import RowFile, Tell, fresh, is_stream

Row = tuple[float | int | str, ...]


class StandardOutput:
    """Standard output in place of a `RowFile`."""

    path: Path | None = None
    lost = 0

    def put(self, line: str) -> None:
        """Write a line, given without its end."""
        sys.stdout.write(line + "\n")
        sys.stdout.flush()

    def close(self) -> None:
        """Leave the stream open."""


class RowSink:
    """Rows as lines of CSV with 9 digits per number, which are in the file or pipe when `write` returns.

    `path` is the path of the result, or None for standard output.
    """

    def __init__(self, lines: RowFile | StandardOutput, header: Sequence[str]) -> None:
        self.path, self._lines = lines.path, lines
        self._lines.put(",".join(header))

    @property
    def lost(self) -> int:
        """Number of rows that could not be written."""
        return self._lines.lost

    def write(self, row: Row) -> None:
        """Write a row."""
        self._lines.put(",".join(f"{cell:.9g}" if isinstance(cell, float) else str(cell) for cell in row))

    def close(self) -> None:
        """Finish the file, which then has all rows."""
        self._lines.close()


class ParquetSink(RowSink):
    """A sink that writes rows with all digits to a CSV file in the same folder, and converts it to Parquet in `close`.

    The memory stays small, and a killed process loses no row.
    """

    def __init__(self, path: Path, header: Sequence[str], tell: Tell) -> None:
        self._rows, self._header, self._tell = RowFile(rows_path(path), tell), list(header), tell
        super().__init__(self._rows, header)
        self.path = self._target = path

    def write(self, row: Row) -> None:
        """Write a row."""
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


def open_sink(out: Path | None, header: Sequence[str], tell: Tell) -> RowSink | None:
    """Open the sink for a path, where "-" means CSV on standard output, and None means no sink.

    If the file exists, the rows go to path-2, path-3 and so on.

    Raises UsageError for another kind of file.
    """
    if out is None:
        return None
    if str(out) == "-":
        return RowSink(StandardOutput(), header)
    kind = out.suffix.lower()
    if kind not in (".csv", ".parquet"):
        raise UsageError(f"estimates go to a .csv or .parquet file, got {out.name!r}; - is standard output")
    while True:
        try:
            if kind == ".csv":
                return RowSink(RowFile(out if is_stream(out) else fresh(out), tell), header)
            return ParquetSink(fresh(out, rows_path), header, tell)
        except FileExistsError:  # another monitor has just taken the name
            continue
