"""Tables with the rows of two topics, such as a command and a state, where each row has the value of one topic."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pmfid.records.clock import MIN_SAMPLES
from pmfid.types import Floats

#: Greatest part of the rows with both values if input and output have separate rows.
MOST_TOGETHER = 0.05


def join_topics(columns: Mapping[str, Floats]) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Return the columns of input, output and time at the rows of the output (m,), and notes for people.

    The input holds from its stamp to the next stamp, and is averaged from one output to the next. Therefore no time
    between two stamps of the input is lost. If the rows of the columns (n,) have both values, the columns remain
    unchanged.
    """
    u, y = np.isfinite(columns["input"]), np.isfinite(columns["output"])
    if "time" not in columns or np.sum(u & y) > MOST_TOGETHER * min(np.sum(u), np.sum(y)):
        return dict(columns), ()
    known = np.isfinite(columns["time"])
    given, stamps = (columns["time"][known & rows] for rows in (u, y))
    if min(given.size, stamps.size) < MIN_SAMPLES or min(np.min(np.diff(given)), np.min(np.diff(stamps))) <= 0:
        return dict(columns), ()
    values = columns["input"][known & u]
    impulse = np.r_[0.0, np.cumsum(values[:-1] * np.diff(given))]
    ends = np.r_[stamps, stamps[-1] + (stamps[-1] - stamps[-2])]
    late = np.maximum(ends - given[-1], 0.0)
    total = np.interp(ends, given, impulse) + values[-1] * late
    begun = stamps >= given[0]
    joined = {"input": (np.diff(total) / np.diff(ends))[begun], "output": columns["output"][known & y][begun]}
    note = "input and output have separate rows, so each output gets the mean of the input until the next output"
    return {**joined, "time": stamps[begun]}, (note,)
