"""The command `pmfid fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import JSON, config_option, print_json, progress
from pmfid.errors import NotIdentifiableError, printable

if TYPE_CHECKING:
    from pmfid.fleet.history import History

#: Largest number of axes in a printed table.
SHOWN = 30


@click.group(short_help="Many axes: their histories.")
def fleet() -> None:
    """Estimate the histories of many axes, from data sets of any size."""


@fleet.command(short_help="Estimate every axis and period of a data set.")
@click.argument("source", type=click.Path(path_type=Path))
@config_option("Columns of time, input and counts, and all settings that the axes share.")
@click.option("--axis", "by", required=True, metavar="COLUMN", help="Column or folder key that names the axis.")
@click.option(
    "--type",
    "kind",
    metavar="COLUMN",
    help="Column with the type of the axis; only axes of the same type are compared.",
)
@click.option(
    "--period",
    default="day",
    show_default=True,
    metavar="P",
    help="Time of one estimate: day, shift, run, or a duration such as 10min.",
)
@click.option("--workers", type=int, metavar="N", help="Number of threads; default: one for each processor.")
@click.option(
    "--segment",
    type=float,
    metavar="S",
    help="Length of the data for one estimate [s]; a change is found between two estimates.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="FOLDER",
    help="Write fleet.html, fleet.json and Parquet tables into this folder.",
)
@JSON
def history(
    source: Path,
    config: Path,
    by: str,
    kind: str | None,
    period: str,
    workers: int | None,
    segment: float | None,
    out: Path,
    as_json: bool,
) -> None:
    """Estimate every axis of SOURCE for each period, and find axes that change, drift or differ from the others.

    SOURCE is a folder of Parquet or Arrow files with any partition, or a single file. The data have one row for each
    sample of each axis, in any order. The result names unusable data, and uses all other data.

    Exit code 0: a result; 2: wrong usage or unreadable input; 3: no axis can be identified.
    """
    with progress(str(source)) as tell:
        from pmfid.fleet.history import estimate
        from pmfid.report.fleet import write_fleet

        found = estimate(
            source, axis=config, by=by, period=period, type=kind, out=out, segment=segment,
            workers=workers, progress=tell,
        )  # fmt: skip
        write_fleet(out, found, source.name)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found, out)
    if found.unknown.height == found.axes.height:
        problems = found.problems.filter(found.problems["code"] != "type")["text"]
        reason = next(iter(problems), "the motion does not determine every parameter")
        raise NotIdentifiableError(f"no axis of {source} can be identified: {printable(reason)}")


def _print(found: History, out: Path) -> None:
    click.echo(found.title)
    for row in found.named.head(SHOWN).iter_rows(named=True):
        click.echo(f"  {printable(row['axis'])}: {printable(row['why'])}")
    if found.named.height > SHOWN:
        click.echo(f"  ... and {found.named.height - SHOWN} more")
    if found.unknown.height:
        names = ", ".join(printable(axis) for axis in found.unknown["axis"].head(SHOWN))
        click.echo(f"no estimate: {names}{', ...' if found.unknown.height > SHOWN else ''}: see the report")
    for row in found.problems.head(SHOWN).iter_rows(named=True):
        where = row["axis"] or row["file"]
        times = f" ({row['times']} times)" if row["times"] > 1 else ""
        click.echo(f"note: {printable(where)}: {printable(row['text'])}{times}")
    click.echo(f"{found.samples} samples\nreport: {out / 'fleet.html'}")
