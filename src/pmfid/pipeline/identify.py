"""Identification of a record by one method, or by every method."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np

from pmfid.config.axis import Axis
from pmfid.diagnostics.matter import OF_LOG, is_small_doubt, weigh_findings
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import Finding, codes, make_notes, sort_findings
from pmfid.pipeline.drives import Drives
from pmfid.pipeline.fitted import SecondMassError
from pmfid.pipeline.kinds import Kind, Progress, Records
from pmfid.pipeline.processes import Processes
from pmfid.pipeline.result import DriveResult, Result
from pmfid.records.record import Record, read_record

KINDS: dict[str, Kind[Records]] = {
    # each kind receives only records that it has read itself
    "drive": cast("Kind[Records]", Drives()),
    "equation": cast("Kind[Records]", Drives()),
    "transfer_function": cast("Kind[Records]", Processes()),
}


#: Findings on samples that a repair replaced, after which the estimate goes on.
REPAIRED = {"count_jump", "invalid_input"}
#: Findings that a motion refutes if it leaves nothing but rounding or white noise.
REFUTED = ("stuck", "clipped", "rate_low")


def read_machine(path: Path, axis: Axis, purpose: str) -> Record:
    """Read the record of a machine for a purpose. Raises UsageError if AXIS.toml describes a process."""
    if not isinstance(kind_of(axis), Drives):
        raise UsageError(
            f"{purpose} needs a machine, and this AXIS.toml describes a process: for the log of a machine give [model] "
            'kind = "drive", and the travel of a count as [encoder] resolution'
        )
    return read_record(path, axis)


def kind_of(axis: Axis) -> Kind[Records]:
    """Return the kind of plant that [model] describes."""
    return KINDS[axis.model.kind]


def identify(data: Records, axis: Axis, progress: Progress | None = None) -> Result:
    """Estimate the parameters from the records that `kind_of(axis).read` returns.

    `progress` is called while a recursive method runs.

    Raises UsageError if the configuration contradicts the data, and NotIdentifiableError if the data cannot identify
    every parameter. If a mistake in the log explains the error, the message names the mistake first.
    """
    kind, given = kind_of(axis), axis
    axis = kind.settle_axis(data, given)
    try:
        result = kind.estimate(data, axis, progress)
    except NotIdentifiableError as error:
        raise _name_speed(explain_error(error, kind.check_record(data, axis)), data, axis) from error
    log = kind.check_record(data, axis)
    if isinstance(result, DriveResult) and result.explained:
        log = tuple(one for one in log if one.code not in REFUTED)
    notes = list[str]()
    if given.estimator.cutoff != axis.estimator.cutoff:
        cutoff = f"cutoff = {axis.estimator.pole:.6g} rad/s was chosen for this record"
        notes.append(f"{cutoff}; write it into [estimator] for other records")
    return result.with_findings(*log, *make_notes("cutoff", notes))


def _name_speed(error: NotIdentifiableError, data: Records, axis: Axis) -> NotIdentifiableError:
    """Return an error that names max_speed if it excludes changes of the counts, or the error itself."""
    speed = axis.encoder.make_encoder(data.resolution).max_speed if isinstance(data, Record) else None
    if not isinstance(data, Record) or speed is None:
        return error
    excluded = float(np.mean(np.abs(np.diff(data.counts)) * data.resolution > speed * data.dt + data.resolution))
    if not excluded:
        return error
    return NotIdentifiableError(
        f"{error}; [encoder] max_speed excludes {excluded:.0%} of the changes of the counts: check it"
    )


def explain_error(error: NotIdentifiableError, findings: tuple[Finding, ...]) -> NotIdentifiableError:
    """Return an error with the most important mistake in the log, or the error itself if the log has no mistake.

    Two masses whose motion explains every count need no other explanation.
    """
    if isinstance(error, SecondMassError):
        return error
    causes = [finding for finding in findings if finding.severity != "note"]
    return NotIdentifiableError(causes[0].text) if causes else error


def describe_refusal(error: NotIdentifiableError) -> Finding:
    """Return a refusal of the data as a finding."""
    text = str(error)
    sentence, _, remedy = text.partition("; ") if "; " in text else text.rpartition(": ")
    return Finding("refused", sentence, remedy, "wrong")


def check(data: Records, axis: Axis) -> tuple[Finding, ...]:
    """Return possible mistakes in a log, most important first.

    For a machine's log without mistakes, or with samples that a repair replaced, the function also returns the doubts
    of `identify` about the model.
    """
    kind = kind_of(axis)
    log = kind.check_record(data, axis)
    if not isinstance(kind, Drives) or set(codes(log)) - OF_LOG - REPAIRED:
        return log
    try:
        result = cast(DriveResult, identify(data, axis))
    except NotIdentifiableError as error:
        return sort_findings((*log, describe_refusal(error)))
    except UsageError:
        return log
    doubts = [one for one in result.findings if one.severity != "note" and one not in log]
    small = [finding for finding in result.findings if is_small_doubt(finding)]
    return sort_findings((*weigh_findings(log, result.matter), *doubts, *small))
