"""Notices of the service as lines for people."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pmfid.cli.monitor_lines import sentence
from pmfid.errors import printable
from pmfid.stream.outcome import Notice

Fields = dict[str, Any]


def line(notice: Notice) -> str:
    """Return the text of a notice after the name of the axis. The first notice has several lines."""
    what = notice.what
    own = _SENTENCES.get(str(what["event"]))
    text = own(what) if own is not None else _describe_other(what)
    return printable(f"{notice.axis}  {text}" if notice.axis and text else text)


def _describe_other(what: Fields) -> str:
    try:
        return sentence(what)
    except KeyError:  # the event of a source or sink has no own sentence
        rest = ", ".join(f"{key} {value}" for key, value in what.items() if key != "event")
        return f"{what['event']}: {rest}"


def _serving(what: Fields) -> str:
    lines = [f"serving {what['name']}: {what['axes']} ax{'e' if what['axes'] != 1 else 'i'}s"]
    lines += [f"page: {what['page']}"] if "page" in what else []
    lines += [f"note: {note}" for note in what.get("notes", ())]
    kept = f"checkpoints: {what['state']}" if what["state"] else ("no checkpoints: [service] state names no folder")
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


def _describe_fresh(count: int) -> str:
    return f"{_axes(count)} start{'s' * (count == 1)} without an earlier state"


def _reload(what: Fields) -> str:
    changes = ", ".join(f"{_axes(what[key])} {key}" for key in ("added", "changed", "removed") if key in what)
    return "read again: " + "; ".join(part for part in (changes, what.get("problem", "")) if part)


def _problem(what: Fields) -> str:
    name = what.get("source") or what.get("sink") or ""
    return f"{what['event']} {name}: {what.get('problem') or what.get('state', 'works')}".replace(" :", ":")


def _alarm(what: Fields) -> str:
    return f"ALARM  {what['problem']}" if "silent" in what else sentence(what)


def _describe_end(what: Fields) -> str:
    of = {"axis": "", "axes": f" of {what['name']}"}.get(what["silent"], f" of {what['silent']} {what['name']}")
    return f"the alarm{of} is over after {what['seconds']:g} s without data"


def _epoch(what: Fields) -> str:
    off = "" if what["jump"] is None else f", {what['jump']:+.6g} s from where it should be"
    return f"the sender restarted (epoch {what['epoch']}){off}"


def _period(what: Fields) -> str:
    return str(what["problem"])


def _clock(what: Fields) -> str:
    if "problem" in what:
        return str(what["problem"])
    return sentence({**what, "jump": what["jump"] if what["jump"] is not None else float("nan")})


def _describe_acknowledgement(what: Fields) -> str:
    if what["alarm"] is None:
        return str(what["problem"])
    return f"alarm {what['alarm']} acknowledged: {what['note']}"


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
    if "made" not in what:
        return f"no checkpoint: {_describe_fresh(what['fresh'])}"
    restored = f"{_axes(what['restored'])} restored from the last checkpoint"
    text = f"{restored}; {_describe_fresh(what['fresh'])}"
    changed = what.get("changed", ())
    return text + (f", of these with a changed configuration: {', '.join(changed)}" if changed else "")


_SENTENCES: dict[str, Callable[[Fields], str]] = {
    "alarm": _alarm,
    "cleared": _describe_end,
    "serving": _serving,
    "configuration": _configuration,
    "calibration": _calibration,
    "checkpoint": _checkpoint,
    "reload": _reload,
    "source": _problem,
    "sink": _problem,
    "unusable": _problem,
    "epoch": _epoch,
    "period": _period,
    "late": _period,
    "paused": _period,
    "clock": _clock,
    "acknowledged": _describe_acknowledgement,
    "reference": _reference,
    "anew": lambda what: "restarts, and accepts its next samples with any number",
    "ended": lambda what: "ended",
}
