"""A file of any format as a table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pmfid.errors import UsageError
from pmfid.session.formats import (
    FORMATS,
    SUFFIXES,
    arrow_file,
    hdf5_file,
    mcap_file,
    mdf_file,
    numpy_file,
    rosbag_file,
    wpilog_file,
)
from pmfid.session.formats.arrow_file import ArrowTable
from pmfid.session.formats.csv_file import parse_csv
from pmfid.session.formats.excel_file import parse_excel
from pmfid.session.formats.hdf5_file import parse_hdf5
from pmfid.session.formats.layout import NOTHING, Stated
from pmfid.session.formats.mat_file import parse_mat
from pmfid.session.formats.mcap_file import parse_mcap
from pmfid.session.formats.mdf_file import parse_mdf
from pmfid.session.formats.numpy_file import parse_numpy
from pmfid.session.formats.parquet_file import ParquetTable
from pmfid.session.formats.rosbag_file import file_of, parse_rosbag
from pmfid.session.formats.safety import readable, silent
from pmfid.session.formats.tdms_file import MAGIC as TDMS
from pmfid.session.formats.tdms_file import parse_tdms
from pmfid.session.formats.wpilog_file import parse_wpilog
from pmfid.session.tables import Table

#: Suffix -> reader from bytes to columns; `readable` turns errors of a reader into UsageError.
READERS: dict[str, Callable[[bytes], Table]] = {
    ".csv": parse_csv,
    ".parquet": ParquetTable,
    ".mat": parse_mat,
    ".npz": parse_numpy,
    ".xlsx": parse_excel,
    ".arrow": ArrowTable,
    ".h5": parse_hdf5,
    ".wpilog": parse_wpilog,
    ".mcap": parse_mcap,
    ".db3": parse_rosbag,
    ".mf4": parse_mdf,
    ".tdms": parse_tdms,
}
#: Other suffixes of the same formats; text has many, and its layout is found in the file.
ENDINGS = {
    **dict.fromkeys((".txt", ".tsv", ".tab", ".dat", ".asc", ".log", ".trc", ".gz", ".zst"), ".csv"),
    **dict.fromkeys((".hdf5", ".hdf", ".he5"), ".h5"),
    **dict.fromkeys((".feather", ".ipc", ".arrows"), ".arrow"),
    ".npy": ".npz",
    ".pq": ".parquet",
    ".mdf": ".mf4",
    ".xlsm": ".xlsx",
}
#: First bytes of a file -> its format; bytes that a text or several formats may begin with are left out.
OPENINGS: dict[bytes, str] = {
    b"PAR1": ".parquet",
    b"MATLAB 5.0 MAT-file": ".mat",
    b"MATLAB 7.3 MAT-file": ".mat",
    numpy_file.ARRAY: ".npz",
    arrow_file.FILE: ".arrow",
    arrow_file.OLD: ".arrow",
    hdf5_file.SIGNATURE: ".h5",
    wpilog_file.MAGIC: ".wpilog",
    mcap_file.MAGIC: ".mcap",
    rosbag_file.SQLITE: ".db3",
    **dict.fromkeys(mdf_file.MAGIC, ".mf4"),
    TDMS: ".tdms",
}


def read_table(path: Path, stated: Stated = NOTHING) -> Table:
    """All columns of a file of one of the `FORMATS`, not yet converted; stated: the configured layout of a text.

    Raises UsageError with the remedy for a file that is missing, empty, truncated, corrupt or of another type.
    """
    path = file_of(path) if path.is_dir() else path
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the record: {error.strerror}; give the path of a data file") from None
    suffix = path.suffix.lower()
    named = ENDINGS.get(suffix, suffix)
    kind = format_of(data) or named
    if kind not in FORMATS:
        raise UsageError(f"file type {path.suffix!r} is not known; use one of {', '.join(SUFFIXES)}")
    if not data or data.isspace():
        raise UsageError("the file is empty; export the record again")
    with readable(suffix if kind == named else kind), silent():
        table = parse_csv(data, stated) if kind == ".csv" else READERS[kind](data)
    del data  # of the size of the columns, which are copied next
    return _rechunk_table(table)


def _rechunk_table(table: Table) -> Table:
    """The table with each polars series in one piece, which needs no copy as an array. The series are joined one by
    one, because the pieces need as much memory as the result."""
    if isinstance(table, dict):
        for name, column in table.items():
            if hasattr(column, "rechunk"):
                table[name] = column.rechunk()
    return table


def format_of(data: bytes) -> str | None:
    """The format of a file by its first bytes; None if they do not determine it."""
    return next((kind for opening, kind in OPENINGS.items() if data.startswith(opening)), None)
