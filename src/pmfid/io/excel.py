"""Excel workbooks, of which the first sheet with a table is read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.io.csv_text import LOOKED_AT, layout_of, named_columns
from pmfid.io.safety import checked_archive, most_of, require_extra
from pmfid.io.tables import NotedTable

if TYPE_CHECKING:
    import fastexcel

#: Number of bytes in a cell.
CELL = 8


def parse_excel(data: bytes) -> NotedTable:
    """Return the columns without the lines above the table. Raises UsageError if no sheet is a table."""
    checked_archive(data).close()
    with require_extra("excel"):
        import fastexcel
    book = fastexcel.read_excel(data)
    refusal = UsageError("no sheet has lines of numbers in columns: write a header, then one line for each sample")
    for name in book.sheet_names:
        try:
            found = _sheet(book, name, most_of(len(data)))
        except UsageError as error:
            refusal = error
            continue
        others = (f"the sheet {name!r} is read",) if len(book.sheet_names) > 1 else ()
        return NotedTable(found, (*others, *found.notes))
    raise refusal


def _sheet(book: fastexcel.ExcelReader, name: str, most: int) -> NotedTable:
    # The text of the first lines, with the digits of numbers, shows the header. After that, the numbers are read
    # unchanged.
    head = book.load_sheet(name, header_row=None, skip_rows=0, n_rows=LOOKED_AT, dtypes="string")
    if head.width * head.total_height * CELL > most:
        raise UsageError("the sheet declares more cells than its file can hold; delete empty rows and columns")
    lines = head.to_polars().write_csv(separator="\t", include_header=False).splitlines()
    layout = layout_of(lines)
    body = book.load_sheet(name, header_row=None, skip_rows=layout.first).to_polars()
    plain = tuple(note for note in layout.notes if "separated by" not in note)
    return NotedTable(named_columns(body, layout), plain)
