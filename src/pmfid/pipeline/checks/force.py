"""Checks for inputs that are not forces, such as a current without its sign, a command or a set point."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.findings import Finding, Severity
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.pipeline.guess.relations import compare
from pmfid.pipeline.guess.roles import evidence_of, is_commanded
from pmfid.pipeline.tuning import TUNING
from pmfid.types import Floats

__all__ = ["find_command", "find_unsigned"]


def find_unsigned(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input of a reversing axis never changes its sign.

    The finding also requires that the motion explains the input with corrected signs.
    """
    u = log.known.u[log.part]
    if not log.is_machine or np.min(u) * np.max(u) < 0 or np.ptp(u) == 0:
        return
    position = log.known.counts[log.part].astype(np.float64)
    forward = np.sum(np.maximum(np.diff(position), 0)) / max(np.sum(np.abs(np.diff(position))), 1e-300)
    if not TUNING.force_reverses < forward < 1 - TUNING.force_reverses:
        return
    found = [_measure_signs(u, position, width) for width in TUNING.force_widths if u.size > 10 * width]
    plain, signed = min(found, key=lambda pair: pair[1], default=(0.0, 1.0))
    if signed < min(TUNING.force_signed, TUNING.force_better * plain):
        yield Finding(
            "unsigned",
            f"the input column {log.axis.record.input!r} has no sign, but the axis reverses under load",
            "log the force or current with its sign",
            "wrong",
            f"With the right signs, the motion explains {100 * (1 - signed):.3g} % of the input.",
        )


def _measure_signs(u: Floats, position: Floats, width: int) -> tuple[float, float]:
    """Return the unexplained parts of an unsigned input (n,), first as it is and then with the best signs.

    Acceleration, velocity, direction and load explain the input. The best signs are the signs of the explained force.
    All signals are means over `width` samples, which cause no delay.
    """
    from scipy.ndimage import uniform_filter1d  # slow to import, and only an unsigned input needs it

    smooth = uniform_filter1d(uniform_filter1d(position, width), width)
    velocity = np.gradient(smooth)
    columns = np.column_stack([np.gradient(velocity), velocity, np.sign(velocity), np.ones(u.size)])
    columns = uniform_filter1d(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), width, axis=0)
    size = float(np.linalg.norm(u - np.mean(u)))
    left = [_fit(columns, uniform_filter1d(u, width))[1] / size]
    for sign in (np.sign(velocity), np.sign(np.gradient(velocity))):
        for _ in range(TUNING.force_turns):
            force, error = _fit(columns, uniform_filter1d(sign * u, width))
            sign = np.where(force < 0, -1.0, 1.0)
        left.append(error / size)
    return left[0], min(left[1:])


def _fit(columns: Floats, z: Floats) -> tuple[Floats, float]:
    """Return the fit (n,) of columns (n, p) to z (n,), and the norm of the residual."""
    fit = columns @ np.linalg.lstsq(columns, z, rcond=None)[0]
    return fit, float(np.linalg.norm(z - fit))


def find_command(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input is a command, such as the set point of the output or the requested torque of a
    drive.
    """
    name, output = log.axis.record.input, log.axis.record.output
    u, y = log.record.u, log.encoder.position(log.record.counts)
    if not log.is_machine or np.ptp(u) == 0 or np.ptp(y) == 0:
        return
    if is_commanded(name) and float(np.corrcoef(u, y)[0, 1]) > TUNING.force_alike:
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
    if log.place_matters or evidence_of(log.axis.record.input).lean("input") >= TUNING.pairs_clear:
        return None
    moved = np.gradient(y) / log.record.dt if log.axis.record.output_kind == "velocity" else y
    likeness = compare(u[log.part], moved[log.part])
    return likeness.gain if likeness.set_point else None
