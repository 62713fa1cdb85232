"""The command `pmfid selftest`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import JSON, config_option, progress, result_option


@click.command(short_help="Simulate the machine of a result, identify it again, and compare.")
@click.argument("record", type=click.Path(path_type=Path))
@config_option()
@result_option("The result to test, as written by `pmfid identify --out` or --json.")
@click.option("--runs", type=click.IntRange(2, 1000), default=10, show_default=True, help="Simulated records.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the noise.")
@JSON
def selftest(record: Path, config: Path, stored: Path, runs: int, seed: int, as_json: bool) -> None:
    """Simulate the machine of RESULT.json with the input, encoder and noise of RECORD, and identify it again.

    The status is empty if the parameters are recovered within their intervals, and if the record deviates from the
    model no more than simulated records do.

    Exit code 0: a test, passed or not; 2: wrong usage, unreadable input, parameters of another model.
    """
    with progress("selftest") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.selftest import run_selftest
        from pmfid.pipeline.stored import read_stored
        from pmfid.pipeline.validation import read_records
        from pmfid.report.validation import selftest_page

        axis = load_axis(config)
        (data,) = read_records([record], axis)
        found = run_selftest(read_stored(stored), data, axis, runs=runs, seed=seed, tell=tell)
    deliver_page(selftest_page(found), None, as_json)
