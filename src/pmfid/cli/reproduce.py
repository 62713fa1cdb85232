"""The command `pmfid reproduce`: the figures of the paper."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.progress import progress


@click.command(short_help="Reproduce the figures of the paper.")
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
def reproduce(figures: tuple[str, ...], out: Path, seeds: int, jobs: int | None) -> None:
    """Reproduce the figures of the paper: FIG is 2, 3, 4, 5 or encoders; all of them where none is given.

    Writes a picture and a CSV of what is drawn for each figure, and table.csv with the figures of merit over many
    seeded runs of the simulated cart.
    """
    with progress("runs") as tell:
        from pmfid.cli.tables import print_merits
        from pmfid.paper.run import reproduce as run

        rows = run(figures, out, seeds, jobs, tell)
    print_merits(rows, out)
