"""Tables of results for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pmfid.cli.terminal import print_json, print_text
from pmfid.errors import printable
from pmfid.report.page import ResultPage, format_cell

if TYPE_CHECKING:
    from rich.table import Table

    from pmfid.findings import Finding
    from pmfid.pipeline.result import Result


def print_result(result: Result, out: Path | None) -> None:
    """Print the parameters with their standard deviations, the fit, and the findings.

    A transfer function also has poles, zeros and a gain.
    """
    from rich.console import Console

    from pmfid.pipeline.conclusion import conclude
    from pmfid.pipeline.result import DriveResult, ProcessResult

    console, said = Console(), conclude(result)
    print_text(f"{said.sentence}\n  {said.action}")
    table = _parameters(result, console.width)
    if isinstance(result, ProcessResult):
        print_text(str(result.process))
        table.title = f"{table.title}, {result.fit_text}"
        table.add_section()
        for row in result.process.rows:
            table.add_row(*map(_safe, row))
    console.print(table)
    if isinstance(result, DriveResult):
        print_text(f"relative error of the filtered equation: {100 * result.relative_error:.3g} %")
    print_text(f"status: {', '.join(dict.fromkeys(result.status)) or 'none'}")
    lines = finding_lines(result.findings)
    lines += [f"more: pmfid explain {said.word}"] if said.word else []
    lines += [f"report: {out / 'report.html'}"] if out is not None else []
    for line in lines:
        print_text(line)


def finding_lines(findings: Sequence[Finding]) -> list[str]:
    """Return the lines of findings. Doubts below the tolerance share one line."""
    from pmfid.diagnostics.matter import is_small_doubt

    small = dict.fromkeys(finding.code for finding in findings if is_small_doubt(finding))
    lines = [line for finding in findings if not is_small_doubt(finding) for line in finding.lines]
    if small:
        below = f"note: effects outside the model are below the tolerance: {', '.join(small)}"
        lines.append(f"{below}; --json describes them")
    return lines


def _parameters(result: Result, width: int) -> Table:
    """Return the table of parameters. A narrow table has the standard error in brackets and no model spread."""
    from pmfid.pipeline.result import FOLDED, format_short, parameter_header, parameter_rows

    title = f"{result.name}: {result.estimator.method}, {result.samples} samples"
    header, rows = parameter_header(result), parameter_rows(result)
    table = _parameter_table(title, header, rows)
    if _width(table) <= width or FOLDED[0] not in header:
        return table
    numbers = zip(result.theta.tolist(), result.theta_std.tolist(), strict=True)
    short = [
        [row[0], format_short(*pair), row[header.index(FOLDED[1])], row[-1]]
        for row, pair in zip(rows, numbers, strict=True)
    ]
    return _parameter_table(title, ("parameter", "value(std)", FOLDED[1], "unit"), short)


def _parameter_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    from rich.table import Table

    from pmfid.pipeline.result import FOLDED

    table = Table(title=_safe(title))
    for heading in header:
        folds = heading in FOLDED  # the other columns stay whole in a narrow terminal
        side: Literal["left", "right"] = "left" if heading in ("parameter", "unit") else "right"
        table.add_column(heading.replace("model ", "model\n"), justify=side, no_wrap=not folds, overflow="fold")
    for row in rows:
        table.add_row(*map(_safe, row))
    return table


def deliver_page(page: ResultPage, out: Path | None, as_json: bool, **files: str) -> None:
    """Write a page into a folder if one is given, and print it as JSON or for people.

    `files` has the names of further files in the folder, by what they hold.
    """
    if out is not None:
        from pmfid.report.html import write_page

        write_page(out, page)
    if as_json:
        print_json(page.content)
    else:
        print_page(page)
        if out is not None:
            written = files | {"report": f"{page.name}.html"}
            print_text("\n".join(f"{what}: {out / name}" for what, name in written.items()))


def print_page(page: ResultPage) -> None:
    """Print the sentences, tables, files and remarks of a page. Figures and folded sections are left out."""
    for sentence in page.lead:
        print_text(sentence)
    for section in page.sections:
        if section.code:
            print_text(f"\n{section.code}\n")
        if section.table is not None and not section.folded:
            header, rows = section.table
            print_table(section.heading, header, [[format_cell(cell) for cell in row] for row in rows])
    for remark in page.remarks:
        print_text(remark)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, in a narrow terminal as blocks of columns that each begin with the first column."""
    from rich.console import Console

    console = Console()
    for columns in _blocks(header, rows, console.width):
        table = _column_table(title, header, rows, columns)
        # A number is never cut. A wide table exceeds the edge of the terminal.
        Console(width=max(console.width, _width(table))).print(table)
        title = ""


def _blocks(header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[list[int]]:
    """Return groups of columns that fit into `width` characters, each with the first column."""
    blocks = [[0]]
    for column in range(1, len(header)):
        longer = [*blocks[-1], column]
        if len(longer) == 2 or _width(_column_table("", header, rows, longer)) <= width:
            blocks[-1] = longer
        else:
            blocks.append([0, column])
    return blocks


def _column_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], columns: list[int]) -> Table:
    from rich.table import Table

    table = Table(title=_safe(title) or None)
    for heading in (header[column] for column in columns):
        text = _safe(heading.replace("_", "\n").replace(" [", "\n["))
        table.add_column(text, justify="left" if heading in (header[0], "unit") else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(_safe(row[column]) for column in columns))
    return table


def _width(table: Table) -> int:
    """Return the number of characters of a table without a limit of its width."""
    from rich.console import Console

    return Console(width=10_000).measure(table).maximum


def _safe(text: str) -> str:
    """Return an external text for a cell or a title, without control characters or active markup of rich."""
    from rich.markup import escape

    return escape(printable(text))
