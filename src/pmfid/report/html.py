"""The report: one HTML file that needs nothing beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from numbers import Integral, Real
from pathlib import Path

import jinja2

from pmfid.errors import UsageError

Cell = str | int | float
Table = tuple[Sequence[str], Sequence[Sequence[Cell]]]


@dataclass(frozen=True)
class Section:
    """A part of the report.

    heading, text: plain text, an empty line in the text starts a new paragraph; table: (header, rows), numbers are
    shown with 4 digits, text as it is; svg: an <svg> element as from `svg_text`, embedded as it is.
    Raises UsageError where a row of the table has not as many cells as the header.
    """

    heading: str
    text: str = ""
    table: Table | None = None
    svg: str | None = None

    def __post_init__(self) -> None:
        header, rows = self.table or ((), ())
        for number, row in enumerate(rows, 1):
            if len(row) != len(header):
                raise UsageError(
                    f"row {number} of the table {self.heading!r} has {len(row)} cells, the header {len(header)}; "
                    "give one cell per column"
                )


def write_report(path: Path, title: str, sections: Sequence[Section]) -> None:
    """Write the sections to one HTML file in UTF-8; the same sections give the same bytes.

    It has no scripts, links or dates. Raises UsageError where the file cannot be written.
    """
    source = files("pmfid.report").joinpath("templates", "report.html.j2").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    parts = [_part(section, f"s{number}-") for number, section in enumerate(sections, 1)]
    page = environment.from_string(source).render(title=title, sections=parts)
    try:
        path.write_text(page + "\n", "utf-8", newline="\n")
    except OSError as error:
        raise UsageError(
            f"cannot write the report {path}: {error.strerror}; give a path that can be written"
        ) from None


def _part(section: Section, prefix: str) -> dict[str, object]:
    header, rows = section.table or ((), ())
    texts = [[_text(cell) for cell in row] for row in rows]
    numeric = [any(_is_number(row[column]) for row in texts) for column in range(len(header))]
    return {
        "heading": section.heading,
        "paragraphs": [part for part in section.text.split("\n\n") if part.strip()],
        "header": list(zip(header, numeric, strict=True)),
        "rows": [list(zip(row, numeric, strict=True)) for row in texts],
        "svg": _own_ids(section.svg or "", prefix),
    }


def _text(cell: Cell) -> str:
    if isinstance(cell, Real) and not isinstance(cell, Integral):
        return f"{float(cell):.4g}"
    return str(cell)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _own_ids(svg: str, prefix: str) -> str:
    """Put a prefix before each id: two figures on a page number their elements alike."""
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{prefix}", svg)
