"""CSV and its relatives: text with a line for each sample."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.session.formats.layout import LOOKED_AT, NOTHING, Layout, Stated, layout_of
from pmfid.session.formats.packed import unpack_file
from pmfid.session.tables import TWICE, NotedTable

if TYPE_CHECKING:
    import polars as pl

#: First bytes of zlib, bzip2, xz and ZIP.
_PACKED = (b"x\x01", b"x\x9c", b"x\xda", b"BZh9", b"\xfd7zXZ", b"PK\x03\x04")
_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_MISSING = ["", "NA", "N/A", "null", "NULL", "None", "-"]
_COMMENT = re.compile(rb"(?m)^[ \t]*(#|%|//).*(\n|\Z)")
#: Least percentage of zeros at every second byte of a UTF-16 text; first bytes that are examined.
_WIDE, _FIRST = 30, 2000


def parse_csv(data: bytes, stated: Stated = NOTHING) -> NotedTable:
    """The columns as text, numbers with a decimal point; stated: the configured layout. Raises UsageError for other
    packed files than gzip and zstd, and for a file that is no text or no table."""
    text = _text(unpack_file(data))
    head = text[: _end_of_line(text, LOOKED_AT)].decode("utf-8")
    layout = layout_of(head.splitlines(), stated)
    return NotedTable(_columns(text[_end_of_line(text, layout.first) :], layout), layout.notes)


def _text(data: bytes) -> bytes:
    """The text as UTF-8, lines ended by line feeds. Raises UsageError for a file that is no text."""
    if data.startswith(_PACKED):  # polars would unpack it, however large
        raise UsageError("a packed file; unpack it first, and mind how large it becomes")
    coding = next((coding for mark, coding in _MARKS.items() if data.startswith(mark)), None) or _detect_encoding(data)
    if coding is not None:
        data = data.decode(coding).encode("utf-8")
    if b"\0" in data:
        raise UsageError("not a text file; use the suffix of its type, or export it as UTF-8 CSV")
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _detect_encoding(data: bytes) -> str | None:
    """The coding of a text without a mark, None: UTF-8."""
    first = data[:_FIRST]
    for coding, zeros in (("utf-16-le", first[1::2]), ("utf-16-be", first[::2])):
        if 100 * zeros.count(0) > _WIDE * max(1, len(zeros)) and first.count(0) == zeros.count(0):
            return coding
    try:
        if not data.isascii():
            data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return None


def _end_of_line(text: bytes, lines: int) -> int:
    """The place at which the first `lines` lines end."""
    place = 0
    for _ in range(lines):
        found = text.find(b"\n", place)
        if found < 0:
            return len(text)
        place = found + 1
    return place


def _columns(body: bytes, layout: Layout) -> dict[str, object]:
    import polars as pl

    body = _data(body)
    if not body or body.isspace():
        return {name: pl.Series(name, [], dtype=pl.String) for name in layout.names}
    if layout.separator == " ":
        body = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", re.sub(rb"[ \t]+", b" ", body))
    return named_columns(_frame(body, layout), layout)


def _data(body: bytes) -> bytes:
    """The lines of data alone, copied only if there are other lines."""
    if any(mark in body for mark in (b"#", b"%", b"//")):
        body = _COMMENT.sub(b"", body)
    return body.rstrip().removesuffix(b"\nEOF") if body.endswith((b"\n\n", b"EOF", b"EOF\n", b" ", b"\t")) else body


def _frame(body: bytes, layout: Layout) -> pl.DataFrame:
    """The columns with numbers in the first lines as numbers, the others as text. If a later cell is no number, all are
    text, because only a column that is used may cause an error."""
    import polars as pl

    def read(numbers: Sequence[int]) -> pl.DataFrame:
        kinds = {str(k): pl.Float64 if k in numbers else pl.String for k in range(len(layout.names))}
        return pl.read_csv(
            body,
            separator=layout.separator,
            has_header=False,
            schema=kinds,  # with names of its own: those of polars begin with column_0 or column_1
            null_values=_MISSING,
            decimal_comma=layout.decimal == "," and bool(numbers),
        )

    for numbers in (layout.numbers, ()) if layout.numbers else ((),):
        try:
            return read(numbers)
        except pl.exceptions.ComputeError:
            continue
    raise UsageError(
        f"not every line from line {layout.first + 1} on has {len(layout.names)} columns: remove lines that are no "
        "data, as a sum at the end or settings at the beginning"
    )


def named_columns(frame: pl.DataFrame, layout: Layout) -> dict[str, object]:
    """The columns with the names of a layout, text with a decimal point."""
    import polars as pl

    table: dict[str, object] = {}
    for name, column in zip(layout.names, frame.iter_columns(), strict=True):
        text = _with_points(column) if layout.decimal == "," and column.dtype == pl.String else column
        table[f"{name}{TWICE}" if name in table else name] = text.alias(name)
    return table


def _with_points(column: pl.Series) -> pl.Series:
    """Decimal commas as points. A number with points between thousands becomes a text that is no number."""
    import polars as pl

    thousands = column.str.contains(r"^\s*[+-]?\d{1,3}(\.\d{3})+")
    marked = pl.select(pl.when(thousands).then(column + " (with a point for thousands)").otherwise(column)).to_series()
    return marked.str.replace(",", ".", literal=True)
