"""What a fault did: what the page and the metrics said, and whether that is what they should have said."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from pmfid.cli.serve_lines import line
from pmfid.stream.outcome import Notice
from studies.service.hall import Hall, Metrics, Report

#: Metrics that a fault may change; the others change by themselves.
REPORTED = re.compile(
    r"pmfid_(unusable|samples_(missing|dropped|without)|lines_dropped|dropped_|refused|sink_(working|errors)|events"
    r"|checkpoint_(working|errors)|page_|paused_|deliveries_slower_total\{than=.5.\})"
)
#: Letters of a sentence that the table shows.
LONGEST = 240


@dataclass(frozen=True)
class Finding:
    """fault: what happened; page: sentences of the notices; metrics: what changed; claims: what should hold, and
    whether it does."""

    fault: str
    page: Sequence[str]
    metrics: Sequence[str]
    claims: Sequence[tuple[str, bool]]

    @property
    def holds(self) -> bool:
        return all(holds for _, holds in self.claims)

    def row(self) -> str:
        """Of the table."""
        verdict = ["as it should be" if self.holds else "**NOT as it should be**"]
        verdict += [text if holds else f"**NOT: {text}**" for text, holds in self.claims]
        parts = (self.page or ["nothing"], [f"`{one}`" for one in self.metrics] or ["nothing"], verdict)
        cells = [self.fault, *("<br>".join(part).replace("|", "\\|") for part in parts)]
        return f"| {' | '.join(cells)} |"


def sentences(notices: Sequence[Report]) -> list[str]:
    """As the log for people has them, those alike once; not what the motion itself does to the watch, and not the
    start."""
    reported = Counter[str]()
    for one in notices:
        if one["event"] in ("state", "configuration", "serving"):
            continue
        what = {key: value for key, value in one.items() if key not in ("axis", "number", "wall")}
        text = line(Notice(one["axis"], one["number"], one["wall"], what))
        if text:
            reported[text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."] += 1
    return [text if times == 1 else f"{text} ({times} times)" for text, times in reported.items()]


def changes(before: Metrics, after: Metrics) -> list[str]:
    """Totals that grew, levels that changed."""
    found = []
    for name, value in sorted(after.items()):
        if REPORTED.match(name) and 'event="state"' not in name and value != before.get(name, 0.0):
            grew = f"+{value - before.get(name, 0.0):g}" if "_total" in name else f"= {value:g}"
            found.append(f"{name.removeprefix('pmfid_')} {grew}")
    return found


def others_unchanged(hall: Hall, since: int = 0) -> tuple[str, bool]:
    """The first claim of all: nobody else's estimates are touched."""
    rows, differ = hall.compared(since)
    return f"{rows} rows of the other axes to the last bit, {differ} differ", rows > 0 and differ == 0


def without_alarm(notices: Sequence[Report]) -> tuple[str, bool]:
    alarms = sum(one["event"] == "alarm" and "silent" not in one for one in notices)
    return f"{alarms} false alarms", alarms == 0
