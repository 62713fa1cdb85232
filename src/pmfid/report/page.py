"""A result for people and programs: text, tables and figures, which a terminal or an HTML page renders."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmfid.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = str | int | float
Table = tuple[Sequence[str], Sequence[Sequence[Cell]]]


@dataclass(frozen=True)
class Section:
    """A part of a page.

    `heading` and `text` are plain text, in which an empty line starts a new paragraph. `table` has a header and rows.
    Numbers have 4 digits, and text is unchanged. `figure` draws the figure, for matplotlib or as <svg>, which only an
    HTML page has. If `first` is set, the figure stands above text and table, otherwise below. `code` has the lines of a
    file, which are shown unchanged. A `folded` section shows its heading alone until the reader opens it. Raises
    UsageError if the number of cells in a row differs from the header.
    """

    heading: str
    text: str = ""
    table: Table | None = None
    figure: Callable[[], Figure | str] | None = None
    code: str = ""
    first: bool = False
    folded: bool = False

    def __post_init__(self) -> None:
        header, rows = self.table or ((), ())
        for number, row in enumerate(rows, 1):
            if len(row) != len(header):
                raise UsageError(
                    f"row {number} of the table {self.heading!r} has {len(row)} cells, the header "
                    f"{len(header)}; give one cell per column"
                )


@dataclass(frozen=True)
class ResultPage:
    """A result as the files NAME.html and DATA.json, on a terminal, and as the object of --json.

    `content` is the object of DATA.json, and DATA is NAME by default. `lead` are sentences that stand out above the
    sections. `remarks` are the lines of a terminal below the tables, in place of the text of the sections.
    """

    name: str
    title: str
    content: Mapping[str, object]
    sections: Sequence[Section]
    lead: Sequence[str] = ()
    remarks: Sequence[str] = ()
    data: str = ""


def format_cell(cell: Cell) -> str:
    """Return the text of a cell."""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
