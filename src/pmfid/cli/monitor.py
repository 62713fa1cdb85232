"""The command `pmfid monitor`: watches a record or a pipe and says when a parameter changed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click


@click.command()
@click.argument("record", type=click.Path(path_type=Path, allow_dash=True))
@click.option(
    "--config",
    required=True,
    type=click.Path(path_type=Path),
    metavar="AXIS.toml",
    help="With a section [monitor] that names a record of normal work.",
)
@click.option("--mtbf-hours", type=float, metavar="H", help="Mean time between false alarms.")
@click.option(
    "--detector", type=click.Choice(("cusum", "page-hinkley", "glr", "chi-square")), help="What looks for a change."
)
@click.option("--tolerance", type=float, metavar="PART", help="Relative deviation that is no change.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False, allow_dash=True),
    metavar="FILE",
    help="Write every estimate to a .csv or .parquet file; - is standard output, line by line.",
)
@click.option(
    "--report", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.html", help="Write one page on the run."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per event.")
def monitor(
    record: Path, config: Path, out: Path | None, report: Path | None, as_json: bool, **options: float | str | None
) -> None:
    """Watch RECORD, or CSV lines on standard input if it is -, and tell when mass or friction changes.

    Events go to standard output, or to standard error where the estimates go there. Ends at the end of the input and,
    with everything written, at Ctrl-C or SIGTERM.
    """
    from pmfid.session.config import load_axis
    from pmfid.session.monitoring import check_monitored, set_up
    from pmfid.session.records import read_record
    from pmfid.session.stream import Stop

    _check_places(out, report)
    axis = load_axis(config, {f"monitor.{key}": value for key, value in options.items()})
    check_monitored(axis)
    piped = str(record) == "-"
    data = None if piped else read_record(record, axis)
    tell = _Teller(as_json, to_stderr=str(out) == "-")
    with _progress(as_json) as progress:
        setup = set_up(axis, config.parent, data, progress)
    tell.start(setup)
    with Stop().handling() as stop:
        history, run = _run(setup, axis, data, out, stop, tell, report is not None)
    tell.end(run)
    if report is not None and history is not None:
        from pmfid.report.monitored import write_monitored

        write_monitored(report, "standard input" if piped else record.name, setup, run, history)
        tell.line(f"report: {report}")
    if run.problem:
        from pmfid.errors import UsageError

        raise UsageError(run.problem)


def _check_places(*paths: Path | None) -> None:
    """Before the calibration rather than after it."""
    from pmfid.errors import UsageError

    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}; make it, or choose another place")


def _run(setup: Any, axis: Any, data: Any, out: Path | None, stop: Any, tell: _Teller, keep: bool) -> tuple[Any, Any]:
    from pmfid.session.monitor_run import History, header, watch
    from pmfid.session.sinks import open_sink
    from pmfid.session.stream import line_samples, record_samples

    estimator = setup.monitor.estimator
    piped = line_samples(sys.stdin.buffer, axis, estimator.dt, stop)
    samples = piped if data is None else record_samples(data, stop)
    history = History() if keep else None
    sink = open_sink(out, header(setup.monitor))
    try:
        run = watch(samples, setup.monitor, sink, tell, [history] if history else [])
    finally:
        sink.close()
    return history, run


class _Teller:
    """Prints events, as JSON or for people."""

    def __init__(self, as_json: bool, to_stderr: bool) -> None:
        self._json, self._stderr = as_json, to_stderr

    def __call__(self, event: dict[str, Any]) -> None:
        if self._json:
            import json

            self.line(json.dumps(event, allow_nan=False), machine=True)
        else:
            from pmfid.cli.monitor_lines import sentence

            self.line(sentence(event))

    def line(self, text: str, machine: bool = False) -> None:
        """A line at once; with --json only machine readable ones."""
        if text and (machine or not self._json):
            click.echo(text, err=self._stderr)
            (sys.stderr if self._stderr else sys.stdout).flush()

    def start(self, setup: Any) -> None:
        """What is watched and how."""
        from pmfid.session.monitoring import start_object

        self(start_object(setup))

    def end(self, run: Any) -> None:
        """The totals; what was skipped also on standard error, where it is seen."""
        from pmfid.cli.monitor_lines import skipped

        totals = run.totals()
        self({"event": "end", **totals, **({"problem": run.problem} if run.problem else {})})
        if parts := skipped(totals):
            click.echo(f"skipped: {', '.join(parts)}", err=True)


def _progress(quiet: bool) -> Any:
    from contextlib import nullcontext

    if quiet or not sys.stderr.isatty():
        return nullcontext(None)
    from pmfid.cli.tables import progress_bar

    return progress_bar(10**9, False, "calibration")
