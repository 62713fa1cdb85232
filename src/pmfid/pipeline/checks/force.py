"""Checks for inputs that are not forces, such as a current without its sign, a command or a set point."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.findings import Finding, Severity
from pmfid.pipeline.checks.readings import READINGS_UNSEEN, is_exchanged
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.pipeline.guess.relations import compare
from pmfid.pipeline.guess.roles import PAIRS_CLEAR, evidence_of, is_commanded
from pmfid.types import Floats

#: Smallest correlation of a command with the output that it sets.
FORCE_ALIKE = 0.9


def find_unsigned(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input of a reversing axis never changes its sign, and a load does not explain it."""
    u = log.known.u[log.part]
    if not log.is_machine or log.view is None or np.min(u) * np.max(u) < 0 or np.ptp(u) == 0:
        return
    left = log.view.unexplained * np.linalg.norm(log.view.z) / max(np.std(log.view.z) * log.view.z.size**0.5, 1e-300)
    if not log.view.one_way and left > READINGS_UNSEEN and not is_exchanged(log):
        yield Finding(
            "unsigned",
            f"the input column {log.axis.record.input!r} has no sign, but the axis reverses",
            "log the force or current with its sign",
            "wrong",
            f"The motion leaves {100 * left:.3g} % of the changes of the input unexplained.",
        )


def find_command(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input is a command, such as the set point of the output or the requested torque of a
    drive.
    """
    name, output = log.axis.record.input, log.axis.record.output
    u, y = log.record.u, log.encoder.position(log.record.counts)
    if not log.is_machine or np.ptp(u) == 0 or np.ptp(y) == 0:
        return
    if is_commanded(name) and float(np.corrcoef(u, y)[0, 1]) > FORCE_ALIKE:
        sentence = f"the input column {name!r} is the set point of {output!r}, not a force"
        yield Finding("command", sentence, f"log torque or current, or use {name} - {output} as the input", "wrong")
    elif (gain := _measure_gain(log, u, y)) is not None:
        sentence = f"the input column {name!r} has the gain {gain:.2f} of {output!r}, as a set point has"
        severity: Severity = "wrong" if is_commanded(name) or evidence_of(name).lean("input") <= 0 else "doubt"
        remedy = f"log the torque or current that drives {output}, and use it as the input"
        yield Finding("command", sentence, remedy, severity)
    elif is_commanded(name):
        sentence = f"the input column {name!r} has the name of a command, and the drive may have given another torque"
        yield Finding("command", sentence, "use the measured torque or current if the log has one", "note")


def _measure_gain(log: CheckedLog, u: Floats, y: Floats) -> float | None:
    """Return the gain from a set point u (n,) to the output, or None if the input is no set point.

    The name of a force, and a model with a force that depends on the position y (n,), explain a gain of 1.
    """
    if log.place_matters or evidence_of(log.axis.record.input).lean("input") >= PAIRS_CLEAR:
        return None
    moved = np.gradient(y) / log.record.dt if log.axis.record.output_kind == "velocity" else y
    likeness = compare(u[log.part], moved[log.part])
    return likeness.gain if likeness.set_point else None
