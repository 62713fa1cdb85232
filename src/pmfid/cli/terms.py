"""The command `pmfid terms`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import (
    JSON,
    RECORDS,
    SET,
    config_option,
    folder_option,
    progress,
    read_changes,
)


@click.command(short_help="Search the terms of a drive, or the structure of a transfer function.")
@RECORDS
@config_option("The columns, the encoder and the first model.")
@SET
@folder_option("Write terms.html and terms.json into this folder; for a transfer function, order.html.")
@JSON
def terms(
    records: tuple[Path, ...],
    config: Path,
    changes: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Search the terms that the records ask for and the model of AXIS.toml does not have.

    Terms of a drive are Stribeck, quadratic or directional friction, a load, a spring, a dead time, a lag, and forces
    along the travel. For a transfer function, the command searches 1 to 5 poles, fewer zeros, and dead times of 0 to 5
    samples.

    The fit of `pmfid identify` compares all forces. The table shows the odds and the size of each force, and how far
    the parameters move by it. The result belongs to the recommended model.

    Exit code 0: a search with any result; 2: wrong usage or unreadable input; 3: the record shows too little.
    """
    if _is_process(config):
        _search_order(records, config, read_changes(changes), out, as_json)
        return
    with progress("terms"):
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.drives import Drives
        from pmfid.pipeline.terms import search_drive
        from pmfid.report.terms import terms_page

        axis = load_axis(config, read_changes(changes))
        found = search_drive(Drives().read(records, axis), axis)
    deliver_page(terms_page(found), out, as_json)


def _is_process(config: Path) -> bool:
    """Return whether a configuration has a transfer function. Errors in the file are left to its reader."""
    from tomllib import TOMLDecodeError, loads

    try:
        model = loads(config.read_text(encoding="utf-8")).get("model")
    except (OSError, UnicodeDecodeError, TOMLDecodeError):
        return False
    return isinstance(model, dict) and model.get("kind") == "transfer_function"


def _search_order(
    records: tuple[Path, ...], config: Path, changes: dict[str, object], out: Path | None, as_json: bool
) -> None:
    """Search the structure of a transfer function, without n, m and delay of the configuration."""
    structure = {"model.kind": "transfer_function", "model.n": 1, "model.m": 0, "model.delay": 0}
    structure |= {"model.integrators": 0, "model.dead_time": 0.0}
    with progress("structures") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.processes import Processes, search_order
        from pmfid.report.result import search_page

        axis = load_axis(config, changes | structure)
        search = search_order(Processes().read(records, axis), axis, tell)
    deliver_page(search_page(search, records[0].name), out, as_json)
