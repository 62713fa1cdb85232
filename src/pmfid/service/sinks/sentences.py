"""Notices as sentences for a phone, in the words of the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pmfid.monitor.events import describe_changes, describe_rate
from pmfid.stream.outcome import Notice

Fields = Mapping[str, Any]


def sentence(notice: Notice) -> str:
    """Return the sentence of a notice, with the name of its axis at the beginning."""
    what = notice.what
    text = _SENTENCES.get(str(what.get("event")), _describe_other)(what)
    return f"{notice.axis}: {text}" if notice.axis else text


def _describe_alarm(what: Fields) -> str:
    if "silent" in what:
        return str(what["problem"])
    others = f", or {_write_words(what['others'])}" if what.get("others") else ""
    text = " and ".join(map(_describe_change, (what, *what.get("further", ())))) + others
    return f"{text}. {what['advice']}" if what.get("advice") else text


def _describe_change(what: Fields) -> str:
    name, relative = _write_words(what.get("parameter", "a parameter")), _get_finite(what.get("relative"))
    error = "" if (std := _get_finite(what.get("std"))) is None else f" ± {std:.2g}"
    unit = f" {what['unit']}" if what.get("unit") else ""
    size = "" if (change := _get_finite(what.get("change"))) is None else f" ({change:+.3g}{error}{unit})"
    if relative is None:
        return f"{name} has changed{size}"
    return f"{name} is {100 * abs(relative):.3g} % {'lower' if relative < 0 else 'higher'} than normal{size}"


def _describe_end(what: Fields) -> str:
    name = "" if what.get("silent") == "axis" else f" of {what.get('silent')} {what.get('name')}"
    return f"the silence{name} is over after {what.get('seconds', 0.0):.0f} s"


def _describe_values(what: Fields) -> str:
    values = what.get("parameters", {}).items()
    words = ", ".join(f"{_write_words(name)} {found['value']:.4g}" for name, found in values)
    return f"now {words}{describe_changes(what)}{describe_rate(what.get('rate'))}"


def _describe_acknowledgement(what: Fields) -> str:
    note = f': "{what["note"]}"' if what.get("note") else ""
    return f"alarm {what.get('alarm', what.get('number'))} acknowledged{note}"


def _describe_other(what: Fields) -> str:
    if what.get("problem"):
        return str(what["problem"])
    shown = {key: value for key, value in what.items() if key not in ("event", "time") and not _is_table(value)}
    details = ", ".join(f"{_write_words(key)} {value}" for key, value in shown.items() if value not in ("", None))
    return f"{what.get('event')}: {details}" if details else str(what.get("event"))


def _is_table(value: object) -> bool:
    return isinstance(value, dict | list | tuple)


def _get_finite(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _write_words(name: object) -> str:
    return str(name).replace("_", " ")


_SENTENCES: dict[str, Callable[[Fields], str]] = {
    "alarm": _describe_alarm,
    "cleared": _describe_end,
    "settled": _describe_values,
    "acknowledged": _describe_acknowledgement,
}
