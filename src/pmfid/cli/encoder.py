"""The command `pmfid encoder`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import JSON, config_option, folder_option, progress


@click.command(short_help="Show which encoder a parameter needs, with and without edge times.")
@click.argument("record", type=click.Path(path_type=Path))
@config_option()
@click.option(
    "--want",
    type=float,
    default=1.0,
    show_default=True,
    metavar="PERCENT",
    help="Wanted standard deviation of the parameter.",
)
@click.option("--parameter", metavar="NAME", help="Parameter to determine; default: the mass or inertia.")
@click.option(
    "--line-error",
    type=float,
    default=1.0,
    show_default=True,
    metavar="PERCENT",
    help="Largest position error of the encoder's lines, in percent of a step.",
)
@folder_option("Write encoder.html and encoder.json into this folder.")
@JSON
def encoder(
    record: Path,
    config: Path,
    want: float,
    parameter: str | None,
    line_error: float,
    out: Path | None,
    as_json: bool,
) -> None:
    """Show how well encoders of several steps would know a parameter of the axis of RECORD.

    The command identifies RECORD, simulates the machine at the estimate with the same input, and reads the simulated
    motion with each encoder. Edge times are the instants of the counts, as the timer of a motor controller takes them.
    For two masses, the deviations belong to least squares for a motion that crosses counts all the time.

    Exit code 0: a comparison; 2: wrong usage or unreadable input; 3: the record cannot identify the parameters.
    """
    with progress("encoder") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.encoders import compare_encoders
        from pmfid.pipeline.identify import read_machine
        from pmfid.report.encoders import encoder_page

        axis = load_axis(config)
        data = read_machine(record, axis, "a comparison of encoders")
        found = compare_encoders(data, axis, want / 100, line_error / 100, parameter, tell)
    deliver_page(encoder_page(found), out, as_json)
