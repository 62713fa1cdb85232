"""The command `pmfid check`."""

from __future__ import annotations

from pathlib import Path

import click

from pmfid.cli.tables import finding_lines
from pmfid.cli.terminal import JSON, RECORDS, config_option, print_json, print_text, progress
from pmfid.findings import codes

EXIT_FOUND, EXIT_WRONG = 1, 3


@click.command(short_help="Say what is wrong with a log, before anything is estimated.")
@RECORDS
@config_option("The columns of the record, the encoder and the model.")
@JSON
@click.pass_context
def check(ctx: click.Context, records: tuple[Path, ...], config: Path, as_json: bool) -> None:
    """Report mistakes in RECORD, each with a remedy.

    Possible mistakes are a wrong sign, exchanged columns and a velocity in place of a position. A counter may wrap,
    stop or repeat counts. An input may be clipped, held or measured with another clock. The sample rate may be
    unsuitable, or the motion too small. A correct log is tested for unmodelled effects, in the words of `pmfid
    identify`.

    Exit code 0: notes at most; 1: a finding that moves the estimate; 2: wrong usage or unreadable input; 3: nothing can
    be identified from this record as it is read.
    """
    with progress("check"):
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.guess.axis_file import find_to_do
        from pmfid.pipeline.identify import check as run
        from pmfid.pipeline.identify import kind_of

        axis = load_axis(config)
        kind = kind_of(axis)
        data = kind.read(records, axis)
        name, samples = kind.name_and_samples(data)
        found = (*run(data, axis), *find_to_do(config))
    faults = codes(found)
    if as_json:
        print_json({"record": name, "samples": samples, "findings": [finding.to_json() for finding in found]})
    else:
        said = "" if faults else ", nothing wrong found" if found else ", nothing found"
        print_text("\n".join([f"{name}: {samples} samples{said}", *finding_lines(found)]))
    wrong = any(finding.severity == "wrong" for finding in found)
    ctx.exit(EXIT_WRONG if wrong else EXIT_FOUND if faults else 0)
