"""The command `pmfid validate`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import (
    JSON,
    RECORDS,
    config_option,
    folder_option,
    progress,
    result_option,
)


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
        from pmfid.report.validation import validation_page

        axis = load_axis(config)
        found = validate_stored(read_stored(stored), read_records(records, axis), axis)
    deliver_page(validation_page(found), out, as_json)
