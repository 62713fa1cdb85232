"""The command `pmfid friction`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import JSON, config_option, folder_option, progress


@click.command(short_help="Show friction over velocity without assuming a law.")
@click.argument("record", type=click.Path(path_type=Path))
@config_option()
@folder_option("Write friction.html and friction.json into this folder.")
@JSON
def friction(record: Path, config: Path, out: Path | None, as_json: bool) -> None:
    """Find the friction of RECORD over the velocity as a curve, together with the mass.

    The command ignores the friction of [model]. The curve covers only the velocities of the record.

    Exit code 0: a curve; 2: wrong usage or unreadable input; 3: the record does not separate friction from other
    forces.
    """
    with progress("friction"):
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.friction import record_curve
        from pmfid.pipeline.identify import read_machine
        from pmfid.report.friction import curve_page

        axis = load_axis(config)
        found = record_curve(read_machine(record, axis, "a friction curve"), axis)
    deliver_page(curve_page(found, record.name), out, as_json)
