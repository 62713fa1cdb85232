"""The command `pmfid validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import (
    JSON,
    RECORDS,
    config_option,
    folder_option,
    print_json,
    progress,
    result_option,
)

if TYPE_CHECKING:
    from pmfid.pipeline.validation import Validation


@click.command(short_help="Predict other records with a result, by free-run simulation.")
@RECORDS
@config_option("The columns of the records, the encoder and the model; [estimator] gives only the cutoff.")
@result_option("The result to test, as written by `pmfid identify --out` or --json.")
@folder_option("Write validation.html and validation.json into this folder.")
@JSON
def validate(records: tuple[Path, ...], config: Path, stored: Path, out: Path | None, as_json: bool) -> None:
    """Simulate each RECORD from its input alone, with the parameters of RESULT.json, and compare with its output.

    The first samples, over 5 time constants of the filters, determine the start of the simulation. The simulation uses
    no other samples of the output.

    Exit code 0: a prediction, good or bad; 2: wrong usage, unreadable input, parameters of another model.
    """
    with progress("validate"):
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.stored import read_stored
        from pmfid.pipeline.validation import read_records, validate_stored

        axis = load_axis(config)
        found = validate_stored(read_stored(stored), read_records(records, axis), axis)
        if out is not None:
            from pmfid.report.validation import write_validation

            write_validation(out, found)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found, out)


def _print(found: Validation, out: Path | None) -> None:
    from pmfid.cli.tables import print_lines, print_table
    from pmfid.report.validation import horizon_rows, run_rows

    (header, runs), (names, horizons) = run_rows(found), horizon_rows(found)
    rows = [[name, *(row[column] for row in runs)] for column, name in enumerate(header) if column]
    for every in dict.fromkeys(row[1] for row in horizons):
        for column in (3, 4):
            cells = {row[0]: row[column] for row in horizons if row[1] == every}
            text = f"{names[column]}, restarted every {every} s"
            rows.append([text, *(cells.get(row[0], "–") for row in runs)])
    print_table(f"free run, parameters by {found.method}", ["", *(row[0] for row in runs)], rows)
    status = [f"status: {', '.join(found.status)}"] if found.status else []
    print_lines([*status, *(f"note: {note}" for note in found.notes)], out, "validation.html")
