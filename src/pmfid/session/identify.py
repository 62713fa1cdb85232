"""From a record and a configuration to a result: one way for every kind of plant."""

from __future__ import annotations

from contextlib import suppress
from typing import cast

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import Finding, codes, make_notes, sort_findings, texts
from pmfid.judge.matter import OF_LOG, weigh_findings
from pmfid.session.config import Axis
from pmfid.session.drives import Drives
from pmfid.session.kinds import Kind, Progress, Records
from pmfid.session.processes import Processes
from pmfid.session.result import DriveResult, Result

#: Flags of results that a mistake in the columns may explain, however long it takes to find.
SUSPICIOUS = {"implausible", "uncertain", "count_jump", "fallback", "not_followed", "unmodelled"}
KINDS: dict[str, Kind[Records]] = {
    # a kind gets what it has read itself, which is one of these
    "drive": cast("Kind[Records]", Drives()),
    "equation": cast("Kind[Records]", Drives()),
    "transfer_function": cast("Kind[Records]", Processes()),
}


def kind_of(axis: Axis) -> Kind[Records]:
    """The kind of plant that [model] describes."""
    return KINDS[axis.model.kind]


def identify(data: Records, axis: Axis, progress: Progress | None = None) -> Result:
    """Estimates the parameters from the records that `kind_of(axis).read` gives; `progress` is called while a recursive
    method runs.

    Raises UsageError for a configuration that does not fit the data, and NotIdentifiableError if the data cannot
    identify every parameter. A mistake in the log that explains the error is named first.
    """
    kind, given = kind_of(axis), axis
    axis = kind.prepare_axis(data, given)
    kind.check(data, axis)
    whole = kind.complete_record(data, axis)
    if whole is not data:  # the complete record may suit another pole
        data, axis = whole, kind.prepare_axis(whole, given)
    try:
        result = kind.estimate(data, axis, progress)
    except NotIdentifiableError as error:
        raise explain_error(error, kind.check_record(data, axis)) from None
    suspicious = bool(SUSPICIOUS & set(result.status))
    log = kind.check_record(data, axis) if suspicious else kind.scan_record(data, axis)
    return result.with_findings(*log, *make_notes("cutoff", describe_choices(given, axis)))


def describe_choices(given: Axis, prepared: Axis) -> tuple[str, ...]:
    """The settings that were chosen by the record, for people."""
    if given.estimator.cutoff == prepared.estimator.cutoff:
        return ()
    cutoff = f"cutoff = {prepared.estimator.pole:.6g}"
    return (f"{cutoff} rad/s was chosen by this record; write it into [estimator] to keep it for others",)


def explain_error(error: NotIdentifiableError, findings: tuple[Finding, ...]) -> NotIdentifiableError:
    """The same error, after the mistakes in the log that may have caused it."""
    mistakes = "; ".join(texts(findings))
    return NotIdentifiableError(f"{mistakes}; as the record is read now: {error}") if mistakes else error


def check(data: Records, axis: Axis) -> tuple[Finding, ...]:
    """Possible mistakes in a log, most important first. For a machine's log without mistakes, the doubts of `identify`
    in the model."""
    kind = kind_of(axis)
    log = kind.check_record(data, axis)
    if not isinstance(kind, Drives) or set(codes(log)) - OF_LOG:
        return log
    with suppress(NotIdentifiableError, UsageError):
        result = cast(DriveResult, identify(data, axis))
        doubts = (finding for finding in result.findings if finding.severity != "note")
        return sort_findings((*weigh_findings(log, result.matter), *doubts))
    return log
