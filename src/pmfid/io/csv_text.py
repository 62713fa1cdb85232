"""Text files: separators, decimal marks, header lines and units."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.io.safety import unpack_file
from pmfid.io.tables import TWICE, NotedTable

if TYPE_CHECKING:
    import polars as pl

#: Separators, most likely first. A space stands for any number of spaces and tabs.
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
#: Number of examined lines.
LOOKED_AT = 400
#: Smallest percentage of fields in a line of data that are numbers, times or empty.
NUMBERS = 50
#: Beginnings of lines without data.
COMMENTS = ("#", "%", "//")
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eE][+-]?\d+)?"),
}
_DATE = r"(?:\d{4}-\d\d-\d\d|\d{4}/\d\d?/\d\d?|\d\d?[./-]\d\d?[./-]\d{4})"
_TIME = re.compile(rf"({_DATE}[T ])?\d{{1,2}}:\d\d(:\d\d([.,]\d+)?)?( ?[AaPp][Mm])?(Z|[+-]\d\d:?\d\d)?|{_DATE}")
_WORDS = ("", "na", "n/a", "nan", "null", "none", "inf", "-inf", "+inf", "infinity", "true", "false")
_UNIT = re.compile(
    r"[\[(]?\s*(-|%|#|1|[Hh]{1,2}:[Mm]{2}:[Ss]{2}([.,]\w+)?|s|ms|[uµμ]s|ns|sec|m|mm|[uµμ]m|nm|cm|rad|mrad|deg|°|rev|turns?|inc|counts?|cts?|pulses?|m?[VAN]|"
    r"N\s?m|Nm|kg|Hz|rpm|1/min|bool|°C|(m|mm|rad|deg|rev|turns?|°|cts|counts)(/s|/s2|/s\^2|\s?s-1))\s*[\])]?"
)


@dataclass(frozen=True)
class Layout:
    """The layout of a text file.

    `separator` and `decimal` are the marks of the file. `names` are the names of the columns, with a unit in brackets
    from a row of units. `first` is the number of the first line of data, counted from 0. `named` says whether the file
    has a header. `numbers` are the columns, counted from 0, with only numbers in the examined lines.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    first: int
    named: bool
    numbers: tuple[int, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on a layout without commas, decimal points or a header."""
        notes = []
        if (self.separator, self.decimal) != (",", "."):
            sign = "points" if self.decimal == "." else "commas"
            notes.append(f"the columns are separated by {SEPARATORS[self.separator]}, with decimal {sign}")
        if not self.named:
            notes.append(f"the file has no header: its columns are {', '.join(self.names[:8])}")
        return tuple(notes)


@dataclass(frozen=True)
class Stated:
    """The configured part of a layout. If an entry is None, the text itself determines the layout."""

    separator: str | None = None
    decimal: str | None = None


NOTHING = Stated()


def layout_of(lines: Sequence[str], stated: Stated = NOTHING) -> Layout:
    """Return the layout of the first lines of a file. Raises UsageError if they are no table with the stated layout."""
    looked = lines[:LOOKED_AT]
    rows = {mark: list(_fields(looked, mark)) for mark in stated.separator or _find_separators(looked)}
    readings = product(rows, stated.decimal or ".,")
    found = {(mark, decimal): kept for mark, decimal in readings if (kept := _data(rows[mark], decimal))}
    if not found and sum(bool(line.strip()) for line in looked) == 1:
        return _empty(looked)
    if not found:
        raise UsageError(
            "the file has no lines of numbers in columns: write a header, then one line for each sample, with a comma, "
            "semicolon or tab between the columns"
        )
    separator, decimal = max(
        found, key=lambda reading: _worth([split(looked[k], reading[0]) for k in found[reading]], reading[1])
    )
    first = found[separator, decimal][0]
    fields = split(looked[first], separator)
    names, named = _names(looked[:first], separator, fields)
    lines_of_data = [split(looked[k], separator) for k in found[separator, decimal]]
    filled = [[field for field in column if field] for column in zip(*lines_of_data, strict=True)]
    numbers = tuple(k for k, own in enumerate(filled) if own and all(map(_NUMBER[decimal].fullmatch, own)))
    if not named and len(fields) > 1 and fields in ([str(k + start) for k in range(len(fields))] for start in (0, 1)):
        return Layout(separator, decimal, tuple(fields), first + 1, True, numbers)
    return Layout(separator, decimal, names, first, named, numbers)


def _find_separators(lines: Sequence[str]) -> list[str]:
    """Return the separators in the lines, and the first of the others, because all others give the same fields."""
    found = [
        mark for mark in SEPARATORS if any(mark in line if mark != " " else len(line.split()) > 1 for line in lines)
    ]
    other = next((mark for mark in SEPARATORS if mark not in found), None)
    return [mark for mark in SEPARATORS if mark in found or mark == other]


def _empty(lines: Sequence[str]) -> Layout:
    """Return the layout of a file with a header and no data."""
    header = next(line for line in lines if line.strip())
    separator = max(SEPARATORS, key=lambda mark: (len(split(header, mark)), mark != " "))
    return Layout(separator, ".", tuple(split(header.strip().lstrip("#%/ "), separator)), len(lines), True)


def split(line: str, separator: str) -> list[str]:
    """Return the fields of a line without surrounding spaces and quotes."""
    parts = (
        line.split() if separator == " " else next(csv.reader([line], delimiter=separator, skipinitialspace=True), [""])
    )
    return [part.strip().strip('"').strip() for part in parts]


def _worth(rows: Sequence[Sequence[str]], decimal: str) -> tuple[bool, float, int]:
    """Return a sort key for the readings of the rows.

    The key prefers several columns to a single column, then a large part of fields with numbers, and then many lines.
    """
    fields = [field for row in rows for field in row]
    known = sum(_is_data_field(field, decimal) for field in fields)
    return len(rows[0]) > 1, known / len(fields), len(rows)


def _data(rows: Sequence[tuple[int, list[str]]], decimal: str) -> list[int]:
    """Return the lines of data: most of their fields are numbers, and their number of fields is the most frequent
    one.
    """
    sized = [(k, len(fields)) for k, fields in rows if _numeric(fields, decimal)]
    if not sized:
        return []
    usual = Counter(count for _, count in sized).most_common(1)[0][0]
    return [k for k, count in sized if count == usual]


def _fields(lines: Sequence[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    for k, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith(COMMENTS):
            yield k, split(line, separator)


def _numeric(fields: Sequence[str], decimal: str) -> bool:
    """Return whether the fields belong to a line of data, which has a number and few words.

    A line of settings with a word before each number is no line of data.
    """
    words = [field for field in fields if not _is_data_field(field, decimal)]
    if len(words) > 1 and set(words) == {fields[0]}:
        return False
    known = len(fields) - len(words)
    return any(_NUMBER[decimal].fullmatch(field) for field in fields) and 100 * known >= NUMBERS * len(fields)


def is_data(line: str) -> bool:
    """Return whether a line holds data without a word, however its fields are separated."""
    rows = ((split(line, separator), decimal) for separator, decimal in product(SEPARATORS, ".,"))
    return any(len(row) > 1 and all(_is_data_field(field, decimal) for field in row) for row, decimal in rows)


def _is_data_field(field: str, decimal: str) -> bool:
    return bool(_NUMBER[decimal].fullmatch(field) or _TIME.fullmatch(field)) or field.lower() in _WORDS


def _names(above: Sequence[str], separator: str, fields: Sequence[str]) -> tuple[tuple[str, ...], bool]:
    """Return the names of the columns for the fields of the first line of data, and whether the file has names.

    The names come from the nearest line above with the same number of fields, which may be a comment. The units come
    from a row of units.
    """
    lines = [split(line.strip().lstrip("#%/ "), separator) for line in above]
    if scope := _scope_names([line for line in lines if len(line) == len(fields)]):
        return scope, True
    rows = [_fit_line(line, fields) for line in reversed(lines)]
    rows = [row for row in rows if any(field.rstrip(";").strip().lower() not in _WORDS for field in row)]
    if not rows:
        return tuple(f"column_{k}" for k in range(1, len(fields) + 1)), False
    header, units = rows[0], [""] * len(fields)
    if len(rows) > 1 and (are_units(header) or (_repeats(header) and not _repeats(rows[1]))):
        header, units = rows[1], [unit.strip("[]() ") for unit in header]
    names = [name or f"column_{k}" for k, name in enumerate(header, 1)]
    return tuple(f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)), True


def _repeats(row: Sequence[str]) -> bool:
    """Return whether two fields are equal, as two units may be, but not two names."""
    texts = [field for field in row if field]
    return len(set(texts)) < len(texts)


def _scope_names(lines: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names of an export of TwinCAT Scope, or an empty tuple for any other file.

    In an export of TwinCAT Scope, each line of settings repeats its key above each column of stamps [ms].
    """
    settings = {line[0]: line for line in lines if line.count(line[0]) * 2 <= len(line)}
    if not {"Name", "SampleTime[ms]"} <= set(settings):
        return ()
    units = settings.get("Unit", [""] * len(settings["Name"]))
    names = []
    for k, (name, unit) in enumerate(zip(settings["Name"], units, strict=True)):
        stamps = "time [ms]" if k == 0 else f"time_{k} [ms]"
        names.append(stamps if name == "Name" else f"{name} [{unit}]" if unit and unit != "Unit" else name)
    return tuple(names)


def are_units(fields: Sequence[str]) -> bool:
    """Return whether all fields of a row are units."""
    return all(_UNIT.fullmatch(field) for field in fields if field)


def _fit_line(line: list[str], fields: Sequence[str]) -> list[str]:
    """Return the line if its number of fields fits, or an empty list.

    A line may have one field less if the last field is empty.
    """
    if len(line) == len(fields) - 1 and not fields[-1]:
        line = [*line, ""]
    return line if len(line) == len(fields) else []


#: First bytes of zlib, bzip2, xz and ZIP.
_PACKED = (b"x\x01", b"x\x9c", b"x\xda", b"BZh9", b"\xfd7zXZ", b"PK\x03\x04")
_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
MISSING = ["", "NA", "N/A", "null", "NULL", "None", "-"]
_COMMENT = re.compile(rb"(?m)^[ \t]*(#|%|//).*(\n|\Z)")
#: Smallest percentage of zeros at every second byte of a UTF-16 text, and number of examined first bytes.
_WIDE, _FIRST = 30, 2000


def parse_csv(data: bytes, stated: Stated = NOTHING) -> NotedTable:
    """Return the columns as text, with decimal points in numbers. `stated` is the configured layout.

    Raises UsageError for packed files other than gzip and zstd, and for a file that is no text or no table.
    """
    text = decode_text(unpack_file(data))
    head = text[: find_end_of_line(text, LOOKED_AT)].decode("utf-8")
    layout = layout_of(head.splitlines(), stated)
    cut = () if text.endswith(b"\n") else (_describe_cut(text, layout),)
    table, strays = _columns(text[find_end_of_line(text, layout.first) :], layout)
    return NotedTable(table, (*layout.notes, *strays, *filter(None, cut)))


def _describe_cut(text: bytes, layout: Layout) -> str:
    """Return a note on a last line with fewer fields or decimals than the lines before, or an empty text."""
    *before, last = (split(line, layout.separator) for line in text[-_FIRST:].decode("utf-8", "replace").splitlines())
    decimals = {len(fields[-1].partition(layout.decimal)[2]) for fields in before[1:]}
    whole = len(decimals) != 1 or decimals == {len(last[-1].partition(layout.decimal)[2])}
    if not before or (whole and len(last) == len(before[-1])):
        return ""
    return "the last line of the file ends early, so the file is cut and its last row may be wrong"


def decode_text(data: bytes) -> bytes:
    """Return the text as UTF-8 with line feeds. Raises UsageError for a file that is no text."""
    if data.startswith(_PACKED):  # polars would unpack a file of any size
        raise UsageError("the file is compressed; unpack it, and give the unpacked file")
    coding = next((coding for mark, coding in _MARKS.items() if data.startswith(mark)), None) or _detect_encoding(data)
    if coding is not None:
        data = data.decode(coding).encode("utf-8")
    if b"\0" in data:
        raise UsageError("the file is not text; give it the suffix of its type, or export it as UTF-8 CSV")
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _detect_encoding(data: bytes) -> str | None:
    """Return the coding of a text without a mark, or None for UTF-8."""
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


def find_end_of_line(text: bytes, lines: int) -> int:
    """Return the position at which the first `lines` lines end."""
    place = 0
    for _ in range(lines):
        found = text.find(b"\n", place)
        if found < 0:
            return len(text)
        place = found + 1
    return place


def _columns(body: bytes, layout: Layout) -> tuple[dict[str, object], tuple[str, ...]]:
    """Return the columns of the lines of data, and a note on stray lines that are left out."""
    import polars as pl

    lines, notes = strip_other_lines(body), tuple[str, ...]()
    if not lines or lines.isspace():
        return {name: pl.Series(name, [], dtype=pl.String) for name in layout.names}, ()
    frame = _read(lines, layout, layout.numbers)
    if frame is None:
        lines, notes = drop_strays(body, layout)
        frame = _read(lines, layout, layout.numbers) if notes else None
    if frame is None:
        frame, notes = _read(strip_other_lines(body), layout, ()), ()
    if frame is None:
        raise UsageError(
            f"not every line from line {layout.first + 1} on has {len(layout.names)} columns: remove lines that are "
            "not data, such as a sum at the end or settings at the beginning"
        )
    return named_columns(frame, layout), notes


def drop_strays(body: bytes, layout: Layout) -> tuple[bytes, tuple[str, ...]]:
    """Return the lines of data without stray lines, such as a message in the log of a serial monitor, and a note.

    A stray line has less than half of the numbers of a line of data, or too many fields. If every tenth line is such a
    line, the text has another layout, and no line is left out.
    """
    kept, strays = list[tuple[int, str]](), list[tuple[int, str]]()
    for number, line in enumerate(body.decode("utf-8", "replace").split("\n"), layout.first + 1):
        if not line.strip() or line.lstrip().startswith(COMMENTS):
            continue
        (strays if _is_stray(split(line, layout.separator), layout) else kept).append((number, line))
    if not strays or 10 * len(strays) > len(kept):
        return body, ()
    number, line = strays[0]
    others = f"{len(strays)} lines are no data and are left out, the first is" if len(strays) > 1 else "left out is"
    return "\n".join(line for _, line in kept).encode(), (f"{others} line {number}: {line.strip()[:60]!r}",)


def _is_stray(fields: Sequence[str], layout: Layout) -> bool:
    known = sum(_is_data_field(fields[k], layout.decimal) for k in layout.numbers if k < len(fields))
    return 2 * known < len(layout.numbers) or len(fields) > len(layout.names)


def strip_other_lines(body: bytes) -> bytes:
    """Return only the lines of data. The text is copied only if it has other lines."""
    if any(mark in body for mark in (b"#", b"%", b"//")):
        body = _COMMENT.sub(b"", body)
    return body.rstrip().removesuffix(b"\nEOF") if body.endswith((b"\n\n", b"EOF", b"EOF\n", b" ", b"\t")) else body


def _read(body: bytes, layout: Layout, numbers: Sequence[int]) -> pl.DataFrame | None:
    """Return the columns `numbers` as numbers and all other columns as text, or None if the text has another form.

    If a later cell is not a number, all columns are read as text, because only a used column may cause an error.
    """
    import polars as pl

    if layout.separator == " ":
        body = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", re.sub(rb"[ \t]+", b" ", body))
    kinds = {str(k): pl.Float64 if k in numbers else pl.String for k in range(len(layout.names))}
    try:
        return pl.read_csv(
            body,
            separator=layout.separator,
            has_header=False,
            schema=kinds,  # polars' own names begin with column_0 or column_1
            null_values=MISSING,
            decimal_comma=layout.decimal == "," and bool(numbers),
        )
    except pl.exceptions.ComputeError:
        return None


def named_columns(frame: pl.DataFrame, layout: Layout) -> dict[str, object]:
    """Return the columns with the names of a layout, and with decimal points in texts."""
    import polars as pl

    table: dict[str, object] = {}
    for name, column in zip(layout.names, frame.iter_columns(), strict=True):
        text = _with_points(column) if layout.decimal == "," and column.dtype == pl.String else column
        table[f"{name}{TWICE}" if name in table else name] = text.alias(name)
    return table


def _with_points(column: pl.Series) -> pl.Series:
    """Replace decimal commas by points. A number with points between thousands becomes a text that is not a number."""
    import polars as pl

    thousands = column.str.contains(r"^\s*[+-]?\d{1,3}(\.\d{3})+")
    marked = pl.select(pl.when(thousands).then(column + " (with a point for thousands)").otherwise(column)).to_series()
    return marked.str.replace(",", ".", literal=True)
