"""The files of one identification, whatever the kind of plant."""

from __future__ import annotations

from pathlib import Path

from pmfid.report.process import write_process
from pmfid.report.record import write_drive
from pmfid.session.result import DriveResult, ProcessResult, Result


def write_result(out: Path, result: Result) -> None:
    """Writes report.html and result.json, and of a recursive method on a machine track.parquet, into the folder
    `out`."""
    if isinstance(result, ProcessResult):
        write_process(out, result)
    elif isinstance(result, DriveResult):
        write_drive(out, result)
