"""What there is to say of an axis, in a line: terminal, report and table have it from here."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.fleet.verdicts import CHANGED, DIFFERS, DRIFTS, UNKNOWN, WANDERS, AxisVerdict
from pmfid.session.clock import EPOCHS

#: What the parameters are in a sentence.
_WORDS = {INPUT_GAIN: "force per input", "friction": "all friction"}


def when(time: float) -> str:
    """A time [s], as a date (UTC) where it is one, else as hours, minutes and seconds from zero."""
    if not math.isfinite(time):
        return ""
    if EPOCHS[0] <= time < EPOCHS[1]:
        return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M:%S")
    minutes, second = divmod(round(time), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}"


def format_span(since: float, until: float) -> str:
    """The words for a span from `since` to `until` [s], with a common date once."""
    first, last = when(since), when(until)
    same = " " in first and first.partition(" ")[0] == last.partition(" ")[0]
    return f"between {first} and {last.partition(' ')[2] if same else last}"


def sentence(verdict: AxisVerdict) -> str:
    """Why the axis needs attention, or what else there is to say; empty where there is nothing."""
    what = _WORDS.get(verdict.cause, verdict.cause.replace("_", " "))
    size, std = 100 * verdict.size, 100 * verdict.std
    if verdict.kind == CHANGED:
        return f"{what} {size:+.1f} % ± {std:.1f} % {format_span(verdict.since, verdict.until)}"
    if verdict.kind == DRIFTS:
        if verdict.days >= 1:
            return f"{what} drifts by {size:+.2g} % ± {std:.1g} % per day"
        span = when(verdict.days * 86_400.0)
        return f"{what} drifts by {size * verdict.days:+.2g} % ± {std * verdict.days:.1g} % within {span}"
    if verdict.kind == WANDERS:
        return f"{what} wanders by {size:.2g} % about its mean"
    if verdict.kind == DIFFERS:
        return f"{what} {size:+.0f} % from the median of its type"
    return "no estimate: see its findings" if verdict.kind == UNKNOWN else ""
