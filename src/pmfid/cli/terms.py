"""The command `pmfid terms`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import CUTOFF, JSON, config_option, folder_option, print_json, progress
from pmfid.errors import printable

if TYPE_CHECKING:
    from pmfid.pipeline.terms import TermSearch


@click.command(short_help="Search the terms of a drive: friction, forces, dead time.")
@click.argument("record", type=click.Path(path_type=Path))
@config_option("What the record holds, the encoder, the model to begin with; of [estimator] cutoff and order are used.")
@CUTOFF
@click.option(
    "--held-out",
    type=click.Path(path_type=Path),
    metavar="OTHER",
    help="A second record of the same machine, which a term must help to predict; else parts of RECORD.",
)
@click.option("--turn", type=float, metavar="PERIOD", help="A turn in the unit of y: look for gravity, too.")
@click.option("--pitch", type=float, multiple=True, metavar="PITCH", help="Look for a cogging force of this pitch.")
@click.option(
    "--friction-period", type=float, metavar="PERIOD", help="Look for friction that changes along the travel, too."
)
@click.option("--scan/--no-scan", default=True, help="Look for a cogging force of any pitch, where none is given.")
@folder_option("Write terms.html and terms.json there.")
@JSON
def terms(
    record: Path,
    config: Path,
    cutoff: float | None,
    held_out: Path | None,
    turn: float | None,
    pitch: tuple[float, ...],
    friction_period: float | None,
    scan: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Search what RECORD asks for beyond the model of AXIS.toml: Stribeck, quadratic or directional friction, a load, a
    spring, a dead time, and forces along the travel.

    One term is added at a time, and kept if it is beyond chance and explains data that it was not fitted to.

    Exit code 0: a search, whatever it finds; 2: wrong usage or unreadable input; 3: the record cannot tell.
    """
    with progress("terms") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.terms import list_periodic_forces, search_drive
        from pmfid.records.record import read_record

        axis = load_axis(config, {"estimator.cutoff": cutoff})
        places = list_periodic_forces(turn, pitch, friction_period)
        other = None if held_out is None else read_record(held_out, axis)
        found = search_drive(read_record(record, axis), axis, places, scan, other, tell)
        if out is not None:
            from pmfid.report.terms import write_terms

            write_terms(out, found)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found, out)


def _print(found: TermSearch, out: Path | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from pmfid.report.terms import hidden_rows, model_rows, term_rows

    console = Console()
    rows = (model_rows(found), term_rows(found), hidden_rows(found))
    for title, (header, cells) in zip(("models", "terms", "not seen below"), rows, strict=True):
        if not cells:
            continue
        table = Table(title=escape(printable(f"{found.name}: {title}")))
        for number, name in enumerate(header):
            table.add_column(escape(name.replace(" [", "\n[")), justify="right" if number else "left")
        for row in cells:
            table.add_row(*(escape(printable(cell)) for cell in row))
        # a number is never cut: what does not fit then runs over the edge
        Console(width=max(console.width, Console(width=10_000).measure(table).maximum)).print(table)
    lines = [found.sentence, "", *found.lines, ""]
    lines += [f"status: {', '.join(found.status)}"] if found.status else []
    lines += [f"note: {note}" for note in found.notes]
    lines += [f"report: {out / 'terms.html'}"] if out else []
    for line in lines:
        console.print(printable(line), highlight=False, markup=False, soft_wrap=True)
