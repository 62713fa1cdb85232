"""The HTML of reports, and its file."""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from pmfid.durable import replace_file
from pmfid.report.figures import figure_style, narrow_figure
from pmfid.report.page import ResultPage, Section, format_cell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Number of letters of a name in a figure, and of a cell from which it may be broken into several lines.
HTML_LONG = 24


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` in place of the file at the path, as `durable.replace_file` does. Raises OSError."""
    try:
        replace_file(path, lambda part: part.write_bytes(data))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write an object as JSON, as `write_bytes` does."""
    write_bytes(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def svg(figure: Figure | str) -> str:
    """Return the figure as two <svg> elements for HTML, the second one for a phone. Equal figures give equal text."""
    if isinstance(figure, str):
        return figure
    wide = _draw(figure)
    narrow_figure(figure)
    return f"{wide}\n{_own_ids(_draw(figure), 'phone-')}"


def _draw(figure: Figure) -> str:
    buffer = io.StringIO()
    with figure_style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # the reader's fonts have the glyphs
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = buffer.getvalue()
    # In HTML the parser knows the namespaces of an <svg>. The addresses of the namespaces would look like links.
    return re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", text[text.index("<svg") :])


def write_report(path: Path, title: str, sections: Sequence[Section], lead: Sequence[str] = ()) -> None:
    """Write the sections to one HTML file in UTF-8. Equal sections give equal bytes.

    `lead` are sentences that stand out above the sections. The colour is green after "Good:" and red after "Wrong:".

    The file has no scripts, links or dates. Raises OSError if the file cannot be written.
    """
    source = files("pmfid.report").joinpath("templates", "report.html.j2").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    parts = [_part(section, f"s{number}-") for number, section in enumerate(sections, 1)]
    page = environment.from_string(source).render(title=title, sections=parts, lead=lead)
    # A file name may contain bytes that are no text. Invalid bytes are shown as a question mark.
    write_bytes(path, (page + "\n").encode("utf-8", "replace"))


def write_page(out: Path, page: ResultPage) -> None:
    """Write DATA.json and NAME.html of a page into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{page.data or page.name}.json", page.content)
    write_report(out / f"{page.name}.html", page.title, page.sections, page.lead)


def _part(section: Section, prefix: str) -> dict[str, object]:
    header, rows = section.table or ((), ())
    texts = [[format_cell(cell) for cell in row] for row in rows]
    columns = [[row[column] for row in texts] for column in range(len(header))]
    numeric = [any(map(_is_number, own)) and max(map(len, own)) <= HTML_LONG for own in columns]
    return {
        "heading": section.heading,
        "paragraphs": [part for part in section.text.split("\n\n") if part.strip()],
        "header": list(zip(header, numeric, strict=True)),
        "rows": [list(zip(row, numeric, strict=True)) for row in texts],
        "long": HTML_LONG,
        "code": section.code,
        "svg": "" if section.figure is None else _own_ids(svg(section.figure()), prefix),
        "first": section.first,
        "folded": section.folded,
    }


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _own_ids(svg: str, prefix: str) -> str:
    """Put a prefix before each id, because the elements of two figures on a page have equal numbers."""
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{prefix}", svg)
