"""The command `pmfid fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import JSON, config_option, print_json, progress
from pmfid.errors import NotIdentifiableError, UsageError, printable

if TYPE_CHECKING:
    from pmfid.fleet.data import Engine
    from pmfid.fleet.history import History
    from pmfid.stream.groups import Prepared

FOLDER = click.Path(path_type=Path, file_okay=False)
MASTER = click.option(
    "--master", metavar="URL", help='Master of Spark, such as "local[2]"; default: the configured one, or this machine.'
)
_CHECKPOINT = "Folder of the state with which the next call continues."


@click.command(short_help="Watch many axes on Spark, as their blocks arrive.")
@click.argument("source", type=click.Path(path_type=Path))
@config_option("The settings that all axes share.")
@click.option("--out", type=FOLDER, required=True, metavar="FOLDER", help="Folder for estimates and notices.")
@click.option("--checkpoint", type=FOLDER, required=True, metavar="FOLDER", help=_CHECKPOINT)
@click.option("--shards", type=click.IntRange(1, 65536), default=8, show_default=True, help="Number of shards.")
@click.option("--window", type=click.FloatRange(0, 600), default=0.5, show_default=True, help="Reordering window [s].")
@click.option(
    "--every",
    type=click.FloatRange(0, 1e6),
    default=1.0,
    show_default=True,
    help="Time between two written estimates of an axis [s]; 0: write all.",
)
@click.option(
    "--interval", type=click.FloatRange(0, 86400), default=5.0, show_default=True, help="Time between batches [s]."
)
@click.option(
    "--files",
    type=click.IntRange(1),
    metavar="N",
    help="Maximum number of Parquet files in a batch; default: no limit.",
)
@click.option(
    "--state",
    type=FOLDER,
    metavar="FOLDER",
    help="Begin with the states that `pmfid serve` or `pmfid fleet state` has written.",
)
@click.option("--once", is_flag=True, help="End after all present files are read.")
@MASTER
def stream(
    source: Path,
    config: Path,
    out: Path,
    checkpoint: Path,
    shards: int,
    window: float,
    every: float,
    interval: float,
    files: int | None,
    state: Path | None,
    once: bool,
    master: str | None,
) -> None:
    """Watch the axes whose blocks arrive in the folder SOURCE until an interruption.

    SOURCE holds Parquet files with two columns: axis, the name, and block, the bytes of docs/wire.md. SOURCE may also
    hold growing files of blocks in sequence (.pmfb). A repeated block is ignored, an early block waits, and a late
    block is counted. A second call with the same folders continues where the first call ended, for whatever reason.

    Exit code 0: all done; 2: wrong usage, unreadable input, or a configuration that differs from the checkpoint's.
    """
    from pmfid.fleet.shards import States, StreamPlan
    from pmfid.fleet.spark.stream import Pacing, kind_of, stream_files
    from pmfid.stream.groups import Pace

    kind_of(source)  # a wrong argument fails before the slow part
    prepared = _prepare(config)
    plan = StreamPlan(prepared, Pace(window, every), shards)
    begin = None if state is None else States.from_folder(state, prepared.digest)
    stream_files(source, plan, checkpoint, out, Pacing(interval, files, once), begin, master)


@click.command(short_help="Copy the states of axes from a stream, for pmfid serve or Python.")
@click.argument("checkpoint", type=FOLDER)
@config_option("The AXIS.toml of the stream.")
@click.option("--axis", "axes", multiple=True, metavar="NAME", help="Copy only this axis; may be repeated.")
@click.option(
    "--out",
    type=FOLDER,
    required=True,
    metavar="FOLDER",
    help="Folder: [service] state of PLANT.toml.",
)
@MASTER
def state(checkpoint: Path, config: Path, axes: tuple[str, ...], out: Path, master: str | None) -> None:
    """Write the states of axes in CHECKPOINT, written by `pmfid fleet stream`, as the checkpoint of a service.

    `pmfid serve` with [service] state = FOLDER continues from the written states, as does `pmfid fleet stream --state
    FOLDER`.

    Exit code 0: written; 2: no states, states of another configuration, or no such axis.
    """
    from pmfid.fleet.spark.stream import check_states, states_of
    from pmfid.stream.groups import Pace

    check_states(checkpoint)  # a wrong argument fails before the slow part
    prepared = _prepare(config)
    written = states_of(checkpoint, prepared.digest, master).write(out, prepared, Pace(), axes)
    click.echo(f"states of {written} axes: {out}")


def _prepare(config: Path) -> Prepared:
    with progress("calibration") as tell:
        from pmfid.stream.groups import prepare

        return prepare(config, progress=tell)


#: Largest number of axes in a printed table.
SHOWN = 30


@click.group(short_help="Many axes: their histories, and streams of their blocks.")
def fleet() -> None:
    """Estimate the histories of many axes, from data sets of any size, and watch their present state."""


fleet.add_command(stream)
fleet.add_command(state)


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
@click.option(
    "--engine",
    type=click.Choice(["local", "spark"]),
    default="local",
    show_default=True,
    help="Where to compute: on this machine, or on Spark.",
)
@click.option(
    "--master", metavar="URL", envvar="SPARK_MASTER", help="Master of Spark, such as local[4] or spark://host:7077."
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
    help="Write fleet.html, fleet.json and Parquet tables into this folder; the next call reuses finished work.",
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
    """Estimate every axis of SOURCE for each period, and find axes that change, drift or differ from the others.

    SOURCE is a folder of Parquet or Arrow files with any partition, or a single file. The data have one row for each
    sample of each axis, in any order. A second call with the same folder computes only new and changed parts. The
    result names unusable data, and uses all other data.

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
        reason = next(iter(problems), "the motion does not determine every parameter")
        raise NotIdentifiableError(f"no axis of {source} can be identified: {printable(reason)}")


def _engine(name: str, master: str | None, workers: int | None) -> Engine:
    from pmfid.fleet.data import Local
    from pmfid.fleet.spark.engine import Spark

    if name == Local.name:
        return Local(workers)
    if workers is not None:
        raise UsageError("--workers belongs to the engine local; for Spark, give the number with --master 'local[4]'")
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
    done = f"{found.shards - found.reused} of {found.shards} shards computed, the others reused"
    click.echo(f"{found.samples} samples; {done}\nreport: {out / 'fleet.html'}")
