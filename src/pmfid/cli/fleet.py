"""The commands `pmfid fleet ...`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.fleet_stream import state, stream
from pmfid.cli.options import JSON, config_option
from pmfid.cli.output import print_json
from pmfid.cli.progress import progress
from pmfid.errors import NotIdentifiableError, UsageError, printable

if TYPE_CHECKING:
    from pmfid.fleet.history import History
    from pmfid.fleet.local import Engine

#: Axes that are printed.
SHOWN = 30


@click.group(short_help="Many axes: their histories, and streams of their blocks.")
def fleet() -> None:
    """What many axes have been through, from data sets of any size, and what they go through now."""


fleet.add_command(stream)
fleet.add_command(state)


@fleet.command(short_help="Estimates of every axis and period of a data set.")
@click.argument("source", type=click.Path(path_type=Path))
@config_option("The columns of time, input and counts, and what all axes have in common.")
@click.option(
    "--axis", "by", required=True, metavar="COLUMN", help="Column, or key of the folders, that tells the axes."
)
@click.option("--type", "kind", metavar="COLUMN", help="Column of the axes' type: spread is judged within one.")
@click.option("--period", default="day", show_default=True, metavar="P", help="day, shift, run, or a duration: 10min.")
@click.option(
    "--engine",
    type=click.Choice(["local", "spark"]),
    default="local",
    show_default=True,
    help="Where the work is done.",
)
@click.option(
    "--master", metavar="URL", envvar="SPARK_MASTER", help="Of Spark: local[4], spark://host:7077; or SPARK_MASTER."
)
@click.option("--workers", type=int, metavar="N", help="Threads; default: as many as there are processors.")
@click.option("--segment", type=float, metavar="S", help="Length of one estimate [s], by which changes are found.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="FOLDER",
    help="Write fleet.html, fleet.json and the tables as Parquet there; what is done is kept for the next call.",
)
@JSON
def history(
    source: Path,
    config: Path,
    by: str,
    kind: str | None,
    period: str,
    engine: str,
    master: str | None,
    workers: int | None,
    segment: float | None,
    out: Path,
    as_json: bool,
) -> None:
    """Estimate every axis of SOURCE, period by period: who changed, who drifts, who differs from the rest.

    SOURCE is a folder of Parquet or Arrow files, partitioned in any way, or a file: a row for each sample of each axis,
    in any order. A second call with the same folder computes only new and changed parts. The result names data that
    cannot be used; all other data are used.

    Exit code 0: a result; 2: wrong usage or unreadable input; 3: no axis can be identified.
    """
    with progress(str(source)) as tell:
        from pmfid.fleet.history import estimate
        from pmfid.report.fleet import write_fleet

        found = estimate(
            source, axis=config, by=by, period=period, type=kind, out=out, segment=segment,
            engine=_engine(engine, master, workers), progress=tell,
        )  # fmt: skip
        write_fleet(out, found, source.name)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found, out)
    if found.unknown.height == found.axes.height:
        problems = found.problems.filter(found.problems["code"] != "type")["text"]
        reason = next(iter(problems), "too little motion for every parameter")
        raise NotIdentifiableError(f"no axis of {source} can be identified: {printable(reason)}")


def _engine(name: str, master: str | None, workers: int | None) -> Engine:
    from pmfid.fleet.local import Local
    from pmfid.fleet.spark.engine import Spark

    if name == Local.name:
        return Local(workers)
    if workers is not None:
        raise UsageError("--workers is of the engine local; Spark takes what its master has: --master 'local[4]'")
    return Spark(master)


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
    done = f"{found.shards - found.reused} of {found.shards} shards computed, the others were there"
    click.echo(f"{found.samples} samples; {done}\nreport: {out / 'fleet.html'}")
