"""The command `pmfid terms`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import CUTOFF, JSON, RECORDS, config_option, folder_option, print_json, print_text, progress
from pmfid.errors import UsageError

if TYPE_CHECKING:
    from pmfid.pipeline.terms import TermSearch


@click.command(short_help="Search the terms of a drive, or the structure of a transfer function.")
@RECORDS
@config_option("The columns, the encoder and the first model; [estimator] gives cutoff and order.")
@CUTOFF
@click.option(
    "--held-out",
    type=click.Path(path_type=Path),
    metavar="OTHER",
    help="Second record of the machine, which a new term must help to predict; default: parts of RECORD.",
)
@click.option("--turn", type=float, metavar="PERIOD", help="Look for gravity, with this travel per turn [unit of y].")
@click.option(
    "--pitch", type=float, multiple=True, metavar="PITCH", help="Look for cogging with this pitch [unit of y]."
)
@click.option(
    "--friction-period",
    type=float,
    metavar="PERIOD",
    help="Look for friction that varies along the travel with this period, in the unit of y.",
)
@click.option("--scan/--no-scan", default=True, help="Look for cogging of any pitch if --pitch is not given.")
@folder_option("Write terms.html and terms.json into this folder; for a transfer function, order.html.")
@JSON
def terms(
    records: tuple[Path, ...],
    config: Path,
    cutoff: float | None,
    held_out: Path | None,
    turn: float | None,
    pitch: tuple[float, ...],
    friction_period: float | None,
    scan: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Search the terms that RECORD asks for and the model of AXIS.toml does not have.

    Terms of a drive are Stribeck, quadratic or directional friction, a load, a spring, a dead time, and forces along
    the travel. For a transfer function, the command searches 1 to 5 poles, fewer zeros, and dead times of 0 to 5
    samples.

    The search adds one term at a time, and keeps a term if it is beyond chance and explains data outside the fit.

    Exit code 0: a search with any result; 2: wrong usage or unreadable input; 3: the record shows too little.
    """
    if _is_process(config):
        _search_order(records, config, cutoff, out, as_json)
        return
    if len(records) > 1:
        raise UsageError("pmfid terms takes one RECORD of a drive; give a second record with --held-out")
    record = records[0]
    with progress("terms") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.terms import list_periodic_forces, search_drive
        from pmfid.records.record import read_record

        axis = load_axis(config, {"estimator.cutoff": cutoff})
        places = list_periodic_forces(turn, pitch, friction_period)
        other = None if held_out is None else read_record(held_out, axis)
        found = search_drive(read_record(record, axis), axis, places, scan, other, tell)
        if out is not None:
            from pmfid.report.terms import write_terms

            write_terms(out, found)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found, out)


def _is_process(config: Path) -> bool:
    """Return whether a configuration has a transfer function. Errors in the file are left to its reader."""
    from tomllib import TOMLDecodeError, loads

    try:
        model = loads(config.read_text(encoding="utf-8")).get("model")
    except (OSError, UnicodeDecodeError, TOMLDecodeError):
        return False
    return isinstance(model, dict) and model.get("kind") == "transfer_function"


def _search_order(
    records: tuple[Path, ...], config: Path, cutoff: float | None, out: Path | None, as_json: bool
) -> None:
    """Search the structure of a transfer function, without n, m and delay of the configuration."""
    structure = {"model.kind": "transfer_function", "model.n": 1, "model.m": 0, "model.delay": 0}
    structure |= {"model.integrators": 0, "model.dead_time": 0.0}
    with progress("structures") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.processes import Processes, search_json, search_order

        axis = load_axis(config, {"estimator.cutoff": cutoff, **structure})
        search = search_order(Processes().read(records, axis), axis, tell)
        if out is not None:
            from pmfid.report.result import write_search

            write_search(out, search, records[0].name)
    if as_json:
        print_json(search_json(search))
    else:
        from pmfid.cli.tables import print_search

        print_search(search, records[0].name, out)


def _print(found: TermSearch, out: Path | None) -> None:
    from pmfid.cli.tables import print_table
    from pmfid.report.terms import hidden_rows, model_rows, term_rows

    print_text(found.sentence)
    print_text("\n".join(["", *found.lines, ""]))
    rows = (model_rows(found), term_rows(found), hidden_rows(found))
    for title, (header, cells) in zip(("models", "terms", "not seen below"), rows, strict=True):
        if cells:
            print_table(f"{found.name}: {title}", header, cells)
    lines = [f"status: {', '.join(found.status) or 'none'}", *(f"note: {note}" for note in found.notes)]
    print_text("\n".join([*lines, *([f"report: {out / 'terms.html'}"] if out else [])]))
