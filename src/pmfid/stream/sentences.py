"""Events of a monitor and of the service as sentences, for a terminal, a log and a phone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pmfid.errors import printable
from pmfid.presentation import format_pair
from pmfid.stream.outcome import Notice

#: An event, as the object for JSON.
Fields = Mapping[str, Any]


def sentence(what: Fields) -> str:
    """Return the sentence of an event, "" for an event that only a program needs."""
    return _SENTENCES.get(str(what.get("event")), _describe_other)(what)


def log_line(what: Fields) -> str:
    """Return the line of an event with its time. The first event of a service has several lines."""
    text = sentence(what)
    if what.get("event") == "alarm":
        since = f"since {what['changed_at']:.2f} s: " if "changed_at" in what else ""
        text = f"ALARM  {since}{text}"
    return f"{what['time']:.2f} s  {text}" if text and _finite(what.get("time")) is not None else text


def notice_line(notice: Notice) -> str:
    """Return the line of a notice after the name of its axis."""
    text = log_line(notice.what)
    return printable(f"{notice.axis}  {text}" if notice.axis and text else text)


def notice_sentence(notice: Notice) -> str:
    """Return the sentence of a notice with the name of its axis at the beginning, for a phone."""
    text = sentence(notice.what)
    return f"{notice.axis}: {text}" if notice.axis else text


# --- monitors ---------------------------------------------------------------------------------------------------------


def describe_cause(what: Fields) -> str:
    """Return the changes of an alarm, or what is silent."""
    if "silent" in what:
        return str(what["problem"])
    others = f", or {_words(what['others'])}" if what.get("others") else ""
    return " and ".join(map(_change, (what, *what.get("further", ())))) + others


def describe_size(what: Fields) -> str:
    """Return the size of an alarm's change in tolerances, or an empty text."""
    if not (what.get("tolerance") and "relative" in what):
        return ""
    return f"{abs(what['relative']) / what['tolerance']:.2g} times the tolerance of {100 * what['tolerance']:g} %"


def _alarm(what: Fields) -> str:
    text = "; ".join(part for part in (describe_cause(what), describe_size(what)) if part)
    return f"{text}. {what['advice']}" if what.get("advice") else text


def _change(what: Fields) -> str:
    name, relative = _words(what.get("parameter", "a parameter")), _finite(what.get("relative"))
    error = "" if (std := _finite(what.get("std"))) is None else f" ± {std:.2g}"
    unit = f" {what['unit']}" if what.get("unit") else ""
    size = "" if (change := _finite(what.get("change"))) is None else f" ({change:+.3g}{error}{unit})"
    if relative is None:
        return f"{name} has changed{size}"
    return f"{name} is {100 * abs(relative):.3g} % {'lower' if relative < 0 else 'higher'} than normal{size}"


def describe_values(what: Fields) -> str:
    """Return the new values after an alarm, and the changes by all samples since."""
    values = ", ".join(f"{_words(name)} {_value(found)}" for name, found in what.get("parameters", {}).items())
    changes = [f"{_words(one['parameter'])} {100 * one['relative']:+.1f} %" for one in what.get("changes", ())]
    others = f", or {_words(what['others'])}" if what.get("others") else ""
    changed = f"; the change is {' and '.join(changes)}{others}" if changes else ""
    return f"now {values}{changed}{_rate(what.get('rate'))}"


def _value(found: Fields) -> str:
    std = _finite(found.get("std"))
    value = f"{found['value']:.4g}" if std is None else " ± ".join(format_pair(found["value"], std))
    return value if found.get("change") is None else f"{value} ({100 * found['change']:+.1f} %)"


def _rate(rate: float | None) -> str:
    """Return the words for a relative change per hour that goes on, or an empty text for None."""
    if rate is None:
        return ""
    unit, hours = ("a day", 24) if abs(rate) < 0.01 else ("an hour", 1)
    return f"; it keeps changing by about {100 * hours * rate:+.2g} % {unit}"


def _state(what: Fields) -> str:
    return str(what["state"]) + (f": {what['reason']}" if what["reason"] else "")


def _clock(what: Fields) -> str:
    if "problem" in what:
        return str(what["problem"])
    size = "" if what["jump"] is None else f" by {what['jump']:+.6g} s"
    return f"the clock jumped{size}, or the logger restarted"


def _outlier(what: Fields) -> str:
    jumped = "counts jumped" if what["signal"] == "counts" else "input jumped or was not a number"
    return f"{jumped}: the sample is left out, and monitoring continues"


# --- the service ------------------------------------------------------------------------------------------------------


def _describe_start(what: Fields) -> str:
    lines = [f"serving {what['name']}: {_axes(what['axes'])}"]
    lines += [f"page: {what['page']}"] if "page" in what else []
    lines += [f"note: {note}" for note in what.get("notes", ())]
    kept = f"checkpoints: {what['state']}" if what["state"] else "no checkpoints: [service] state names no folder"
    return "\n".join([*lines, kept])


def _configuration(what: Fields) -> str:
    if "problem" in what:
        return f"{what['config']}: {what['problem']}"
    if "digest" in what:  # only sinks with a history use the digest
        return ""
    return "\n".join([f"{what['config']}: calibrated", *(f"note: {note}" for note in what["notes"])])


def _calibration(what: Fields) -> str:
    return f"{_axes(what['watched'])} watched, {_axes(what['awaited'])} still being calibrated"


def _axes(count: int) -> str:
    return "1 axis" if count == 1 else f"{count} axes"


def _reload(what: Fields) -> str:
    changes = ", ".join(f"{_axes(what[key])} {key}" for key in ("added", "changed", "removed") if key in what)
    return "read again: " + "; ".join(part for part in (changes, what.get("problem", "")) if part)


def _peer(what: Fields) -> str:
    name = what.get("source") or what.get("sink") or ""
    return f"{what['event']} {name}: {what.get('problem') or what.get('state', 'works')}".replace(" :", ":")


def _describe_end(what: Fields) -> str:
    kind = "" if what.get("silent") == "axes" else f"{what.get('silent')} "
    of = "" if what.get("silent") == "axis" else f" of {kind}{what.get('name')}"
    return f"the silence{of} is over after {what.get('seconds', 0.0):g} s"


def _epoch(what: Fields) -> str:
    off = "" if what["jump"] is None else f", {what['jump']:+.6g} s from where it should be"
    return f"the sender restarted (epoch {what['epoch']}){off}"


def _describe_acknowledgement(what: Fields) -> str:
    if "problem" in what:
        return str(what["problem"])
    note = f': "{what["note"]}"' if what.get("note") else ""
    return f"alarm {what['alarm']} acknowledged{note}"


def _reference(what: Fields) -> str:
    if "problem" in what:
        return f"no new reference: {what['problem']}"
    return f"the values after {what['samples']} samples are the new reference"


def _checkpoint(what: Fields) -> str:
    if "damaged" in what:
        return f"the damaged file of the states is set aside as {what['damaged']}: {what['problem']}"
    if "problem" in what:
        return f"checkpoints: {what['problem']}"
    if "works" in what:
        return "checkpoints are written again"
    fresh = f"{_axes(what['fresh'])} start{'s' * (what['fresh'] == 1)} without an earlier state"
    if "made" not in what:
        return f"no checkpoint: {fresh}"
    changed = f", of these with a changed configuration: {', '.join(what['changed'])}" if what.get("changed") else ""
    return f"{_axes(what['restored'])} restored from the last checkpoint; {fresh}{changed}"


def _describe_other(what: Fields) -> str:
    if what.get("problem"):
        return str(what["problem"])
    shown = {key: value for key, value in what.items() if key not in ("event", "time")}
    details = ", ".join(
        f"{_words(key)} {value}"
        for key, value in shown.items()
        if value not in ("", None) and not isinstance(value, dict | list | tuple)
    )
    return f"{what.get('event')}: {details}" if details else str(what.get("event"))


def _finite(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _words(name: object) -> str:
    return str(name).replace("_", " ")


_SENTENCES: dict[str, Callable[[Fields], str]] = {
    "alarm": _alarm,
    "settled": describe_values,
    "state": _state,
    "gap": lambda what: f"{what['missing']} samples are missing before this one",
    "clock": _clock,
    "outlier": _outlier,
    "cleared": _describe_end,
    "serving": _describe_start,
    "configuration": _configuration,
    "calibration": _calibration,
    "checkpoint": _checkpoint,
    "reload": _reload,
    "source": _peer,
    "sink": _peer,
    "unusable": _peer,
    "epoch": _epoch,
    "acknowledged": _describe_acknowledgement,
    "reference": _reference,
    "anew": lambda what: "restarts, and accepts its next samples with any number",
}
