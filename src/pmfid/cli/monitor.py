"""The command `pmfid monitor`, which watches a record or a pipe and reports changes of parameters."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import SET, config_option, read_changes
from pmfid.errors import UsageError, printable

if TYPE_CHECKING:
    from pmfid.config.axis import Axis
    from pmfid.pipeline.monitored.rows import RowSink
    from pmfid.pipeline.monitored.run import MonitoredRun, RunHistory
    from pmfid.pipeline.monitored.setup import Setup
    from pmfid.pipeline.monitored.stream import Stop
    from pmfid.records.record import Record


@click.command(short_help="Watch a record or a pipe and report changes.")
@click.argument("record", type=click.Path(path_type=Path, allow_dash=True), required=False)
@config_option("AXIS.toml whose section [monitor] names a record of normal work.")
@SET
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False, allow_dash=True),
    metavar="FILE",
    help="Write every estimate to this .csv or .parquet file, or with - to standard output, line by line.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.html",
    help="Write a report of the run to this file.",
)
@click.option(
    "--estimates",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Judge a table of estimates in place of a record: times in the first column, one number per visit.",
)
@click.option("--column", metavar="NAME", help="Column of --estimates with the numbers; default: the second.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per event.")
def monitor(
    record: Path | None,
    config: Path,
    out: Path | None,
    report: Path | None,
    estimates: Path | None,
    column: str | None,
    changes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Watch RECORD and report changes of mass or friction. If RECORD is -, watch CSV lines on standard input.

    With --estimates, find the steps and drifts of a parameter that was estimated at single visits, in both directions.

    Events go to standard output, or to standard error if the estimates go to standard output. The command ends at the
    end of the input, or at Ctrl-C or SIGTERM after all results are written.
    """
    if estimates is not None:
        _judge_estimates(estimates, column, read_changes(changes), as_json)
        return
    if record is None:
        raise click.UsageError("RECORD is missing; give a record, - for lines, or --estimates FILE")
    piped = str(record) == "-"
    tell = _Teller(as_json, to_stderr=str(out) == "-")
    from pmfid.config.axis import load_axis
    from pmfid.pipeline.monitored.setup import check_monitored, set_up
    from pmfid.pipeline.monitored.stream import Stop
    from pmfid.records.joining import make_even
    from pmfid.records.record import read_record

    axis = load_axis(config, read_changes(changes))
    check_monitored(axis)
    inputs = [config, *([] if piped else [record])]
    _check_places(out, report, [*inputs, config.parent / axis.monitor.reference] if axis.monitor.reference else inputs)
    data = None if piped else make_even(read_record(record, axis))
    setup = set_up(axis, config.parent, data)
    with Stop().handling() as stop:
        run, history, sink = _run(setup, axis, data, out, stop, tell, report is not None)
    if report is not None and history is not None:
        _write_report(report, "standard input" if piped else record.name, setup, run, history, tell)
    tell.end(run, sink)
    _complain(run, sink)


def _judge_estimates(path: Path, column: str | None, changes: dict[str, object], as_json: bool) -> None:
    from pmfid.config.axis import VisitSections
    from pmfid.config.toml_file import override_sections
    from pmfid.fleet.visits import describe_changes, read_visits

    tolerance = override_sections(VisitSections, {}, changes).monitor.tolerance
    for event in describe_changes(read_visits(path, column), tolerance):
        if as_json:
            click.echo(json.dumps(event, allow_nan=False))
        else:
            click.echo(printable(str(event["text"])))


def _check_places(out: Path | None, report: Path | None, inputs: list[Path]) -> None:
    """Check the paths before the calibration."""
    for path in (out, report):
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: the folder {path.parent} does not exist; make it, or choose another path")
    for path in inputs:
        if report is not None and report.exists() and path.exists() and report.samefile(path):
            raise UsageError(f"--report {report} would overwrite {path}; choose another name")


def _write_report(path: Path, name: str, setup: Setup, run: MonitoredRun, history: RunHistory, tell: _Teller) -> None:
    """Write the report. The report of a pipe replaces no other report, because its data exist nowhere else."""
    from pmfid.io.row_file import fresh, is_stream
    from pmfid.report.monitored import write_monitored

    place = path if name != "standard input" or is_stream(path) else fresh(path)
    write_monitored(place, name, setup, run, history)
    tell.line(f"report: {place}")


def _run(
    setup: Setup, axis: Axis, data: Record | None, out: Path | None, stop: Stop, tell: _Teller, keep: bool
) -> tuple[MonitoredRun, RunHistory | None, RowSink | None]:
    """Return the run, its history, and the sink of the estimates."""
    from pmfid.pipeline.monitored.rows import open_sink
    from pmfid.pipeline.monitored.run import RunHistory, header, watch
    from pmfid.pipeline.monitored.stream import line_samples, record_samples

    sink = open_sink(out, header(setup.monitor), tell)
    history = RunHistory() if keep else None
    try:
        tell.start(setup, None if sink is None else sink.path)
        piped = line_samples(sys.stdin.buffer, axis, setup.monitor.estimator.dt, stop)
        samples = piped if data is None else record_samples(data, stop)
        run = watch(samples, setup.monitor, sink, tell, [history] if history else [])
    finally:
        if sink is not None:
            sink.close()
    return run, history, sink


def _complain(run: MonitoredRun, sink: RowSink | None) -> None:
    """Raise UsageError for a problem that ended the run early, or for rows that are missing in the file."""
    if run.problem:
        raise UsageError(run.problem)
    if sink is not None and sink.lost:
        raise UsageError(f"{sink.lost} rows are missing in {sink.path}; free space there, or choose another file")


class _Teller:
    """A printer of events, as JSON or as text for people."""

    def __init__(self, as_json: bool, to_stderr: bool) -> None:
        self._json, self._stderr, self._failed = as_json, to_stderr, False

    def __call__(self, event: dict[str, object]) -> None:
        if self._json:
            self.line(json.dumps(event, allow_nan=False), machine=True)
        else:
            from pmfid.cli.monitor_lines import sentence

            self.line(sentence(event))

    def line(self, text: str, machine: bool = False) -> None:
        """Print a line at once, with --json only if the line is machine readable. A full disk does not end the run."""
        if not text or (self._json and not machine):
            return
        try:
            click.echo(text, err=self._stderr)
            (sys.stderr if self._stderr else sys.stdout).flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            self._failed = self._failed or _report_failure(error)

    def start(self, setup: Setup, out: Path | None) -> None:
        """Print the settings of the run, and the file of the estimates."""
        self({**setup.describe_start(), "out": None if out is None else str(out)})

    def end(self, run: MonitoredRun, sink: RowSink | None) -> None:
        """Print the totals. The number of skipped lines goes to standard error, where a user sees it."""
        from pmfid.pipeline.monitored.run import list_skipped

        totals = run.totals()
        self({"event": "end", **totals, "rows_lost": 0 if sink is None else sink.lost, "problem": run.problem})
        if parts := list_skipped(totals):
            click.echo(f"skipped: {', '.join(parts)}", err=True)


def _report_failure(error: OSError) -> bool:
    """Report on standard error that events cannot be written, and return True."""
    with suppress(OSError):
        click.echo(f"pmfid: events cannot be written: {error.strerror}; monitoring continues", err=True)
    return True
