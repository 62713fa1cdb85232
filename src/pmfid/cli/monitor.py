"""The command `pmfid monitor`, which watches a record and reports changes of parameters."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmfid.cli.terminal import SET, config_option, read_changes
from pmfid.errors import UsageError, printable

if TYPE_CHECKING:
    from pmfid.pipeline.monitored.run import MonitoredRun


@click.command(short_help="Watch a record and report changes.")
@click.argument("record", type=click.Path(path_type=Path), required=False)
@config_option("AXIS.toml whose section [monitor] names a record of normal work.")
@SET
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write every estimate to this .csv or .parquet file.",
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
    """Watch RECORD and report changes of mass or friction. To watch a pipe, use `pmfid serve AXIS.toml`.

    With --estimates, find the steps and drifts of a parameter that was estimated at single visits, in both directions.
    """
    if estimates is not None:
        _judge_estimates(estimates, column, read_changes(changes), as_json)
        return
    if record is None:
        raise click.UsageError("RECORD is missing; give a record, or --estimates FILE")
    if str(record) == "-":
        raise UsageError("a record is a file; to watch lines on standard input, use: pmfid serve AXIS.toml")
    from pmfid.config.axis import load_axis
    from pmfid.pipeline.monitored.run import watch
    from pmfid.pipeline.monitored.setup import check_monitored, set_up
    from pmfid.records.joining import make_even
    from pmfid.records.record import read_record

    axis = load_axis(config, read_changes(changes))
    check_monitored(axis)
    reference = [config.parent / axis.monitor.reference] if axis.monitor.reference else []
    _check_places(out, report, [config, record, *reference])
    data = make_even(read_record(record, axis))
    setup = set_up(axis, config.parent, data)
    _print_event(setup.describe_start(), as_json)
    run = watch(data, setup.monitor)
    for event in (*run.events, {"event": "end", **run.totals}):
        _print_event(event, as_json)
    if out is not None:
        _write_estimates(out, run)
    if report is not None:
        from pmfid.report.monitored import write_monitored

        write_monitored(report, setup, run)


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
    """Check the paths of results before the calibration."""
    if out is not None and out.suffix.lower() not in (".csv", ".parquet"):
        raise UsageError(f"estimates go to a .csv or .parquet file, got {out.name!r}")
    for path in (path for path in (out, report) if path is not None):
        if not path.parent.is_dir():
            raise UsageError(f"{path}: the folder {path.parent} does not exist; make it, or choose another path")
        if same := [other for other in inputs if path.exists() and other.exists() and path.samefile(other)]:
            raise UsageError(f"{path} would replace {same[0]}; choose another name")


def _write_estimates(out: Path, run: MonitoredRun) -> None:
    """Write a row for each sample. Raises UsageError if the disk has no space."""
    from polars.exceptions import PolarsError  # the error that polars raises for a full disk

    from pmfid.durable import replace_file

    frame = run.to_frame()
    try:
        replace_file(out, frame.write_csv if out.suffix.lower() == ".csv" else frame.write_parquet)
    except (OSError, PolarsError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{out}: {reason}; free some space, or choose another folder") from None


def _print_event(event: dict[str, Any], as_json: bool) -> None:
    """Print an event as JSON, or as text for people."""
    from pmfid.stream.sentences import log_line

    describe = {"start": _describe_start, "end": _describe_end}.get(event["event"], log_line)
    click.echo(json.dumps(event, allow_nan=False) if as_json else describe(event))


def _describe_start(event: dict[str, Any]) -> str:
    normal = ", ".join(f"{name} {value:.4g} {event['units'][name]}" for name, value in event["nominal"].items())
    source = ""
    if hours := event.get("record_hours"):
        source = f" (by the scatter of {hours:.3g} h of the reference)"
    elif hours is not None:
        source = " (by the noise of the encoder)"
    lines = [
        f"normal: {normal}",
        f"tolerance {100 * event['tolerance']:g} %, threshold {event['threshold']:.4g}: a false alarm in "
        f"{event['mtbf_hours']:g} h on average{source}",
        *(f"note: {note}" for note in event["notes"]),
    ]
    return "\n".join(lines)


def _describe_end(event: dict[str, Any]) -> str:
    counts = {"sample": event["samples"], "alarm": event["alarms"], "jump": event["outliers"]}
    words = [f"{count} {word}{'s' * (count != 1)}" for word, count in counts.items() if word != "jump" or count]
    return ", ".join(words) + (" left out" if event["outliers"] else "")
