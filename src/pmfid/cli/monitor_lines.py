"""Events of a monitored run as lines for people."""

from __future__ import annotations

from pmfid.monitor.events import describe_changes, describe_rate
from pmfid.pipeline.monitored.run import Notice


def sentence(event: Notice) -> str:
    """Return the text of an event, which is one line, or several lines for the first event."""
    return _SENTENCES.get(event["event"], _problem)(event)


def _start(event: Notice) -> str:
    normal = ", ".join(f"{name} {value:.4g} {event['units'][name]}" for name, value in event["nominal"].items())
    lines = [
        f"normal: {normal}",
        f"tolerance {100 * event['tolerance']:g} %, threshold "
        f"{event['threshold']:.4g}: a false alarm in {event['mtbf_hours']:g} h on average{_describe_source(event)}",
        *(f"note: {note}" for note in event["notes"]),
    ]
    return "\n".join(lines)


def _describe_source(event: Notice) -> str:
    """Return the source of the threshold. The threshold of edges follows from the normal distribution."""
    if "record_hours" not in event:
        return ""
    hours = event["record_hours"]
    return f" (by the scatter of {hours:.3g} h of the reference)" if hours else " (by the noise of the encoder)"


def _alarm(event: Notice) -> str:
    what = " and ".join(_change(one) for one in (event, *event.get("further", ())))
    others = f", or {event['others'].replace('_', ' ')}" if "others" in event else ""
    text = f"{event['time']:.2f} s  ALARM  {what} since {event['changed_at']:.2f} s{others}"
    if event.get("tolerance"):
        times = abs(event["relative"]) / event["tolerance"]
        text += f"; {times:.2g} times the tolerance of {100 * event['tolerance']:g} %"
    return f"{text}. {event['advice']}" if "advice" in event else text


def _change(event: Notice) -> str:
    size = f"{event['change']:+.3g} ± {event['std']:.1g} {event['unit']}".rstrip()
    return f"{event['parameter'].replace('_', ' ')} {100 * event['relative']:+.1f} % ({size})"


def _describe_reference(event: Notice) -> str:
    values = (_value(name, found) for name, found in event["parameters"].items())
    return f"{event['time']:.2f} s  now {', '.join(values)}{describe_changes(event)}{describe_rate(event.get('rate'))}"


def _value(name: str, found: Notice) -> str:
    change = "" if found["change"] is None else f" ({100 * found['change']:+.1f} %)"
    return f"{name.replace('_', ' ')} {found['value']:.4g}{change}"


def _state(event: Notice) -> str:
    return f"{event['time']:.2f} s  {event['state']}" + (f": {event['reason']}" if event["reason"] else "")


def _problem(event: Notice) -> str:
    return f"{event['time']:.2f} s  {event['event']}: {event['problem']}"


def _gap(event: Notice) -> str:
    return f"{event['time']:.2f} s  {event['missing']} samples are missing before this one"


def _clock(event: Notice) -> str:
    return f"{event['time']:.2f} s  the clock jumped by {event['jump']:+.6g} s, or the logger restarted"


def _outlier(event: Notice) -> str:
    what = "counts jumped" if event["signal"] == "counts" else "input jumped or was not a number"
    return f"{event['time']:.2f} s  {what}: the sample is left out, and monitoring continues"


def _end(event: Notice) -> str:
    counts = {"sample": event["samples"], "alarm": event["alarms"], "jump": event["outliers"]}
    words = [f"{count} {word}{'s' * (count != 1)}" for word, count in counts.items() if word != "jump" or count]
    return ", ".join(words) + (" left out" if event["outliers"] else "")


_SENTENCES = {
    "start": _start,
    "alarm": _alarm,
    "settled": _describe_reference,
    "state": _state,
    "gap": _gap,
    "clock": _clock,
    "outlier": _outlier,
    "end": _end,
}
