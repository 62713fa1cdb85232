"""Checks of the input for limits that it reaches, and for values logged more slowly than the record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pmfid.findings import Finding
from pmfid.pipeline.checks.counter import period_of
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.types import Floats

#: Number of values below which an input consists of steps, and of the values next to a limit that it is compared
#: with.
INPUTS_LEVELS = 20
#: Relative width of a level of a measured input, and largest part of the rows between the levels.
ONE_LEVEL = 0.1
ONE_LEVEL_ROWS = 0.02
#: Smallest part of the record at a limit. `INPUTS_PILED` is the smallest ratio of rows at the limit to rows at one
#: of the nearest values.
AT_LIMIT = 0.005
INPUTS_PILED = 5.0

LARGER = "log the force or current with a larger range, or record a smaller motion"


def held_input(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input is logged only every few samples. If the model explains the motion, it is a note."""
    u = log.record.u
    every = period_of(np.flatnonzero(np.diff(u))) if _varies(u) else 1
    if every > 1:
        yield Finding(
            "held_input",
            f"the input column {log.axis.record.input!r} changes only at every {every}th row",
            "log the input at the drive's rate, unless the drive holds it for these rows",
            detail="If the drive gets new inputs more often, the log misses a part of the force.",
        )


def find_saturation(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input stays at its largest or smallest value.

    Either the drive limits the input, or the log clips it. The fit compares both.
    """
    u = log.record.u
    if not _varies(u):
        return
    limits = [limit for limit in (float(u.min()), float(u.max())) if _piles_up(u, limit)]
    there = np.isin(u, limits)
    if not limits:
        return
    sentence = (
        f"the input column {log.axis.record.input!r} stays at {' and '.join(f'{limit:.4g}' for limit in limits)} in "
        f"{100 * np.mean(there):.2g} % of the rows"
    )
    first = f"The first of them is row {int(np.argmax(there)) + 1}."
    yield Finding("saturated", sentence, f"if the drive gave more than that, {LARGER}", "note", first)


def note_one_level(inputs: Sequence[Floats], scaling: str) -> list[Finding]:
    """Return a note if the inputs (n,) show the gain at one level only. `scaling` says what depends on the gain."""
    u = np.concatenate([part[np.isfinite(part)] for part in inputs])
    levels = _list_levels(u)
    if not levels:
        return []
    sentence = f"{scaling} at the input {' and '.join(levels)}, and the record has no other input"
    detail = "An input of several sizes shows whether the amplifier is linear."
    return [Finding("gain_level", sentence, severity="note", detail=detail)]


def _list_levels(u: Floats) -> list[str]:
    """Return the two values of an input (n,) or its one size besides zero, or an empty list for any other input."""
    values = np.unique(u)
    if values.size <= 2:
        same = np.allclose(values, -values[::-1])
        return [f"±{values[-1]:.4g}"] if same else [f"{value:.4g}" for value in values]
    size = np.abs(u)
    level = float(np.median(size[2 * size > size.max()]))
    others = (size > ONE_LEVEL * level) & (np.abs(size - level) > ONE_LEVEL * level)
    return [] if np.mean(others) > ONE_LEVEL_ROWS else [f"±{level:.4g}"]


def _varies(u: Floats) -> bool:
    """Return whether the input takes many values."""
    return np.unique(u[:: max(1, u.size // 10_000)]).size > INPUTS_LEVELS


def _piles_up(u: Floats, limit: float) -> bool:
    """Return whether the input is at the limit far more often than at neighbouring values."""
    values, times = np.unique(u, return_counts=True)
    neighbours = np.argsort(np.abs(values - limit))[1 : INPUTS_LEVELS + 1]
    at_limit = int(times[values == limit][0])
    return at_limit >= AT_LIMIT * u.size and at_limit > INPUTS_PILED * float(np.mean(times[neighbours]))
