"""A file of any format as a table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pmfid.errors import UsageError
from pmfid.io import FORMATS, SUFFIXES, numpy_file
from pmfid.io import arrow as arrow_file
from pmfid.io import hdf5 as hdf5_file
from pmfid.io import mdf as mdf_file
from pmfid.io import ros as mcap_file
from pmfid.io import ros as rosbag_file
from pmfid.io import wpilog as wpilog_file
from pmfid.io.arrow import ArrowTable
from pmfid.io.csv_text import NOTHING, Stated, parse_csv
from pmfid.io.excel import parse_excel
from pmfid.io.hdf5 import parse_hdf5, parse_mat
from pmfid.io.mdf import parse_mdf
from pmfid.io.numpy_file import parse_numpy
from pmfid.io.parquet import ParquetTable
from pmfid.io.ros import file_of, parse_mcap, parse_rosbag
from pmfid.io.safety import readable, silent
from pmfid.io.tables import Table
from pmfid.io.tdms import MAGIC as TDMS
from pmfid.io.tdms import parse_tdms
from pmfid.io.wpilog import parse_wpilog

#: Readers from bytes to columns by suffix. `readable` turns errors of a reader into UsageError.
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
#: Other suffixes of the same formats. A text may have many suffixes, and the file itself shows the layout.
ENDINGS = {
    **dict.fromkeys((".txt", ".tsv", ".tab", ".dat", ".asc", ".log", ".trc", ".gz", ".zst"), ".csv"),
    **dict.fromkeys((".hdf5", ".hdf", ".he5"), ".h5"),
    **dict.fromkeys((".feather", ".ipc", ".arrows"), ".arrow"),
    ".npy": ".npz",
    ".pq": ".parquet",
    ".mdf": ".mf4",
    ".xlsm": ".xlsx",
}
#: Format for the first bytes of a file. Beginnings that several formats or a text may have are left out.
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
    """Return all columns of a file of one of the `FORMATS`, without conversion.

    `stated` is the configured layout of a text. Raises UsageError with the remedy for a file that is missing, empty,
    truncated, corrupt or of another type.
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
    del data  # the bytes are as large as the columns, which are copied next
    return _rechunk_table(table)


def _rechunk_table(table: Table) -> Table:
    """Return the table with each polars series in one piece, which needs no copy as an array.

    The series are joined one by one, because the pieces need as much memory as the result.
    """
    if isinstance(table, dict):
        for name, column in table.items():
            if hasattr(column, "rechunk"):
                table[name] = column.rechunk()
    return table


def format_of(data: bytes) -> str | None:
    """Return the format of a file by its first bytes, or None if they do not determine the format."""
    return next((kind for opening, kind in OPENINGS.items() if data.startswith(opening)), None)
