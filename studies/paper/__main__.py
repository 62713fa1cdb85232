"""The figures of the paper as a command: `python -m studies.paper`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pmfid.cli.terminal import progress
from pmfid.errors import PmfidError
from studies.paper.merit import HEADER, Merit, cells
from studies.paper.run import reproduce


@click.command()
@click.argument("figures", nargs=-1, metavar="[FIG]...")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("reproduced"),
    show_default=True,
    metavar="DIR",
    help="Where pictures, their data and the table go.",
)
@click.option("--seeds", type=int, default=200, show_default=True, help="Runs of each row of the table.")
@click.option("--jobs", type=int, help="Processes; as many as there are cores where not given.")
def main(figures: tuple[str, ...], out: Path, seeds: int, jobs: int | None) -> None:
    """Reproduce the figures of the paper: FIG is 2, 3, 4, 5 or encoders; without FIG, all of them.

    Writes a picture and a CSV of what is drawn for each figure, and table.csv with the figures of merit over many
    seeded runs of the simulated cart.
    """
    try:
        with progress("runs") as tell:
            rows = reproduce(figures, out, seeds, jobs, tell)
    except PmfidError as error:
        raise click.UsageError(str(error)) from None
    print_merits(rows, out)


def print_merits(rows: Sequence[Merit], out: Path) -> None:
    """Print the figures of merit in a table for each figure and condition, without empty columns."""
    console = Console()
    for (figure, condition), group in groupby(rows, key=lambda row: (row.figure, row.condition)):
        texts = [cells(row)[2:] for row in group]
        columns = list(zip(HEADER[2:], zip(*texts, strict=True), strict=True))
        given = [(name, values) for name, values in columns if set(values) - {"–", "0"}]
        common = ", ".join(f"{name} {values[0]}" for name, values in given[1:] if len(set(values)) == 1)
        console.print(f"\n{figure}: {condition} ({common})", style="bold", highlight=False, markup=False)
        table = Table(box=None)
        for name, values in given:
            if name == "method" or len(set(values)) > 1:
                heading = name.replace(" [", "\n\\[").replace("increments", "inc")
                table.add_column(heading, justify="left" if name == "method" else "right", no_wrap=True)
        for row in zip(*(values for name, values in given if name == "method" or len(set(values)) > 1), strict=True):
            table.add_row(*map(escape, row))
        console.print(table)
    console.print(f"table, pictures and their data: {out}", highlight=False, markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
