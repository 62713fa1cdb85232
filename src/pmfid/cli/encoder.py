"""The command `pmfid encoder`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import JSON, config_option, folder_option, print_json, progress

if TYPE_CHECKING:
    from pmfid.pipeline.encoders import EncoderChoice


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

    Exit code 0: a comparison; 2: wrong usage or unreadable input; 3: the record cannot identify the parameters.
    """
    with progress("encoder") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.encoders import compare_encoders
        from pmfid.records.record import read_record

        axis = load_axis(config)
        found = compare_encoders(read_record(record, axis), axis, want / 100, line_error / 100, parameter, tell)
        if out is not None:
            from pmfid.report.encoders import write_choice

            write_choice(out, found)
    if as_json:
        print_json(found.to_dict())
    else:
        _print(found, out)


def _print(found: EncoderChoice, out: Path | None) -> None:
    from pmfid.cli.tables import print_lines, print_table

    shown = found.summary()
    print_table(shown.title, shown.header, shown.rows)
    print_lines((found.answer, *(f"note: {note}" for note in found.notes)), out, "encoder.html")
