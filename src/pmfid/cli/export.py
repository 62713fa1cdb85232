"""The command `pmfid export`."""

from __future__ import annotations

import re
from pathlib import Path

import click

from pmfid.cli.terminal import SET, progress, read_changes


@click.command(short_help="Write the estimator of AXIS.toml as C99 for a drive.")
@click.argument("axis_file", metavar="AXIS.toml", type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help="Folder for the C."
)
@click.option(
    "--precision",
    type=click.Choice(["float32", "float64"]),
    help="Arithmetic on the drive; default: that of AXIS.toml.",
)
@click.option("--prefix", metavar="NAME", help="Prefix of all names in the C code; default: the name of AXIS.toml.")
@click.option(
    "--method",
    type=click.Choice(["auto", "rls", "bcrls", "riv"]),
    help="auto: riv, or the times of edges with [encoder] edge_age.",
)
@SET
@click.option("--dt", type=float, metavar="S", help="Sample period of the drive, if AXIS.toml does not give it.")
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    help="A record of the axis: gives the sample period, the pre-filter zeros and the samples of the self-test.",
)
@click.option(
    "--alarm",
    "alarms",
    type=(str, float, float),
    multiple=True,
    metavar="PARAMETER NOMINAL SHIFT",
    help="Add an alarm for a deviation of SHIFT from the NOMINAL value of a parameter; may be repeated.",
)
@click.option("--blocks", is_flag=True, help="Add pmf_block.c, which makes blocks of samples for pmfid serve.")
@click.option("--steps", is_flag=True, help="Pass the time since the last sample to every call, for uneven sampling.")
def export(
    axis_file: Path,
    out: Path,
    prefix: str | None,
    record: Path | None,
    dt: float | None,
    alarms: tuple[tuple[str, float, float], ...],
    blocks: bool,
    steps: bool,
    changes: tuple[str, ...],
    **options: object,
) -> None:
    """Write the estimator of AXIS.toml as C99 that computes the same bits on a drive.

    The folder contains the kernel, its configuration, a header, an example, a Makefile, a CMake file and a self-test.
    """
    given = {f"estimator.{key}": value for key, value in options.items()} | read_changes(changes)
    name = prefix or re.sub(r"\W+", "_", axis_file.stem.lower())
    with progress("export"):
        from pmfid.config.axis import load_axis
        from pmfid.estimators.base import longest_forgetting, memory_of
        from pmfid.estimators.recursive import RecursiveEstimator
        from pmfid.export.firmware import ParameterAlarm, export_firmware
        from pmfid.pipeline.export import check_exportable, drive_estimator, drive_samples
        from pmfid.records.joining import make_even
        from pmfid.records.record import read_record

        axis = load_axis(axis_file, given)
        check_exportable(axis)
        data = None if record is None else make_even(read_record(record, axis))
        estimator = drive_estimator(axis, data, dt, steps)
        samples = None if data is None else drive_samples(estimator, data)
        watched = [ParameterAlarm(*alarm) for alarm in alarms]
        export_firmware(estimator, out, prefix=name, record=samples, alarms=watched, blocks=blocks)
    click.echo(f"{estimator.method}, {estimator.precision}, every {estimator.dt:.9g} s: {out / name}.h")
    if isinstance(estimator, RecursiveEstimator):
        forgetting = longest_forgetting(estimator.forgetting, estimator.precision)
        if forgetting < estimator.forgetting:
            click.echo(
                f"float32 has a memory of {memory_of(forgetting, estimator.dt):.3g} s in place of that of forgetting = "
                f"{estimator.forgetting:.9g}, because larger sums would lose digits; float64 has any memory"
            )
    click.echo(f"the same bits? make -C {out} selftest && {out / 'selftest'}")
