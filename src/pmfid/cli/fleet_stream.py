"""The commands `pmfid fleet stream` and `pmfid fleet state`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.options import config_option
from pmfid.cli.progress import progress

if TYPE_CHECKING:
    from pmfid.stream.groups import Prepared

FOLDER = click.Path(path_type=Path, file_okay=False)
MASTER = click.option(
    "--master", metavar="URL", help='Of Spark, as "local[2]"; default: what is set up, or this machine.'
)
_CHECKPOINT = "What is needed to go on after an end of any kind."


@click.command(short_help="Watch many axes as their blocks come, on Spark.")
@click.argument("source", type=click.Path(path_type=Path))
@config_option("What all axes have in common.")
@click.option("--out", type=FOLDER, required=True, metavar="FOLDER", help="Estimates and notices go there.")
@click.option("--checkpoint", type=FOLDER, required=True, metavar="FOLDER", help=_CHECKPOINT)
@click.option("--shards", type=click.IntRange(1, 65536), default=8, show_default=True, help="Parts of the state.")
@click.option("--window", type=click.FloatRange(0, 600), default=0.5, show_default=True, help="Disorder is sorted [s].")
@click.option(
    "--every", type=click.FloatRange(0, 1e6), default=1.0, show_default=True, help="Rows of an axis [s]; 0: all."
)
@click.option(
    "--interval", type=click.FloatRange(0, 86400), default=5.0, show_default=True, help="Between batches [s]."
)
@click.option("--files", type=click.IntRange(1), metavar="N", help="Parquet files of a batch at most; default: all.")
@click.option(
    "--state", type=FOLDER, metavar="FOLDER", help="Begin with the axes of a `pmfid serve`, or of `fleet state`."
)
@click.option("--once", is_flag=True, help="End when all that is there is done.")
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
    """Watch the axes whose blocks come into the folder SOURCE, until interrupted: estimates, alarms, gaps.

    SOURCE holds Parquet files with the columns axis, its name, and block, the bytes of docs/wire.md; or files of such
    blocks in sequence, .pmfb, which may grow. A repeated block is left out, an early block waits, a late block is
    counted. A second call with the same folders continues from the end of the first one, however it ended.

    Exit code 0: all done; 2: wrong usage, unreadable input, or a configuration that differs from the checkpoint's.
    """
    from pmfid.fleet.spark.stream import Pacing, kind_of, stream_files
    from pmfid.fleet.stream.shard import StreamPlan
    from pmfid.fleet.stream.states import States
    from pmfid.stream.groups import Pace

    kind_of(source)  # before anything takes long
    prepared = _prepare(config)
    plan = StreamPlan(prepared, Pace(window, every), shards)
    begin = None if state is None else States.from_folder(state, prepared.digest)
    stream_files(source, plan, checkpoint, out, Pacing(interval, files, once), begin, master)


@click.command(short_help="The states of axes out of a stream, for pmfid serve or Python.")
@click.argument("checkpoint", type=FOLDER)
@config_option("That of the stream.")
@click.option("--axis", "axes", multiple=True, metavar="NAME", help="Only this one; may be given several times.")
@click.option("--out", type=FOLDER, required=True, metavar="FOLDER", help="[service] state of a PLANT.toml.")
@MASTER
def state(checkpoint: Path, config: Path, axes: tuple[str, ...], out: Path, master: str | None) -> None:
    """Write the states of axes in CHECKPOINT, written by `pmfid fleet stream`, as the checkpoint of a service.

    `pmfid serve` with [service] state = FOLDER goes on with them, and so does `pmfid fleet stream --state FOLDER`.

    Exit code 0: written; 2: no states, of another configuration, or no such axis.
    """
    from pmfid.fleet.spark.stream import check_states, states_of
    from pmfid.stream.groups import Pace

    check_states(checkpoint)  # before anything takes long
    prepared = _prepare(config)
    written = states_of(checkpoint, prepared.digest, master).write(out, prepared, Pace(), axes)
    click.echo(f"states of {written} axes: {out}")


def _prepare(config: Path) -> Prepared:
    with progress("calibration") as tell:
        from pmfid.stream.groups import prepare

        return prepare(config, progress=tell)
