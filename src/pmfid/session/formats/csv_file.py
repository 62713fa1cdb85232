"""CSV files."""

from __future__ import annotations

from pmfid.errors import UsageError
from pmfid.session.tables import TWICE, Table

#: How gzip, zlib, zstd and bzip2 begin.
_PACKED = (b"\x1f\x8b", b"x\x01", b"x\x9c", b"x\xda", b"\x28\xb5\x2f\xfd", b"BZh9")
_MISSING = ["", "NA", "N/A", "null", "NULL", "None"]


def parse_csv(data: bytes) -> Table:
    """The columns as text. Raises UsageError for what is packed, no text, or separated by anything but commas."""
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
        table[f"{name}{TWICE}" if name in table else name] = frame[column]
    return table
