"""A file of any format as a table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pmfid.errors import UsageError
from pmfid.session.formats import SUFFIXES
from pmfid.session.formats.csv_file import parse_csv
from pmfid.session.formats.mat_file import parse_mat
from pmfid.session.formats.parquet_file import ParquetTable
from pmfid.session.formats.safety import readable
from pmfid.session.tables import Table

#: Suffix -> the columns in the bytes of a file; what a reader raises, `readable` turns into a UsageError.
READERS: dict[str, Callable[[bytes], Table]] = {".csv": parse_csv, ".parquet": ParquetTable, ".mat": parse_mat}
#: Other endings of text, of which the layout is found in the file.
TEXT = (".txt", ".tsv", ".tab", ".dat", ".asc", ".log", ".gz")


def read_table(path: Path) -> Table:
    """All columns of a file of one of the `FORMATS`, not yet converted.

    Raises UsageError with the remedy for a file that is missing, empty, truncated, corrupt or of another type.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the record: {error.strerror}; give the path of a data file") from None
    parse = READERS.get(".csv" if path.suffix.lower() in TEXT else path.suffix.lower())
    if parse is None:
        raise UsageError(f"file type {path.suffix!r} is not known; use one of {', '.join(SUFFIXES)}")
    if not data.strip():
        raise UsageError("the file is empty; export the record again")
    with readable(path.suffix.lower()):
        return parse(data)
