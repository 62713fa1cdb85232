"""The command `pmfid friction`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import JSON, config_option, folder_option, print_json, progress

if TYPE_CHECKING:
    from pmfid.pipeline.friction import FrictionCurve


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
        from pmfid.pipeline.friction import curve_json, record_curve
        from pmfid.records.record import read_record

        axis = load_axis(config)
        found = record_curve(read_record(record, axis), axis)
        if out is not None:
            from pmfid.report.friction import write_curve

            write_curve(out, found, record.name)
    if as_json:
        print_json(curve_json(found, record.name))
    else:
        _print(found, record.name, out)


def _print(found: FrictionCurve, name: str, out: Path | None) -> None:
    from pmfid.cli.tables import print_lines, print_table

    own, shown = found.motion, found.summary()
    title = f"{name}: {own.inertia} {found.mass:.5g} ± {found.mass_std:.2g} {own.of_inertia}"
    print_table(title, shown.header, shown.rows)
    print_lines((line for finding in found.findings for line in finding.lines), out, "friction.html")
