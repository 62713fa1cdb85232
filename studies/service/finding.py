"""The effect of a fault: the messages of page and metrics, compared to the right ones."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from studies.service.hall import Hall, Metrics, Report

#: Metrics that a fault may change. All other metrics change by themselves.
REPORTED = re.compile(
    r"pmfid_(unusable|samples_(missing|dropped|without)|lines_dropped|dropped_|refused|sink_(working|errors)|events"
    r"|checkpoint_(working|errors)|page_|deliveries_slower_total\{than=.5.\})"
)
#: Most letters of a sentence in the table.
LONGEST = 240


@dataclass(frozen=True)
class Finding:
    """A fault with its effects: sentences of the notices, changed metrics, and claims with their truth."""

    fault: str
    page: Sequence[str]
    metrics: Sequence[str]
    claims: Sequence[tuple[str, bool]]

    @property
    def holds(self) -> bool:
        return all(holds for _, holds in self.claims)

    def row(self) -> str:
        """Return a row of the table."""
        verdict = ["as it should be" if self.holds else "**NOT as it should be**"]
        verdict += [text if holds else f"**NOT: {text}**" for text, holds in self.claims]
        parts = (self.page or ["nothing"], [f"`{one}`" for one in self.metrics] or ["nothing"], verdict)
        cells = [self.fault, *("<br>".join(part).replace("|", "\\|") for part in parts)]
        return f"| {' | '.join(cells)} |"


def sentences(notices: Sequence[Report]) -> list[str]:
    """Return the sentences of the log, equal ones once; the start, and the motion's effects on the watch, are
    left out.
    """
    reported = Counter[str]()
    for one in notices:
        if one["event"] in ("state", "configuration", "serving"):
            continue
        text = f"{one['axis']}  {one['text']}" if one["axis"] else str(one["text"])
        reported[text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."] += 1
    return [text if times == 1 else f"{text} ({times} times)" for text, times in reported.items()]


def changes(before: Metrics, after: Metrics) -> list[str]:
    """Return the totals that grew, and the levels that changed."""
    found = []
    for name, value in sorted(after.items()):
        if REPORTED.match(name) and 'event="state"' not in name and value != before.get(name, 0.0):
            grew = f"+{value - before.get(name, 0.0):g}" if "_total" in name else f"= {value:g}"
            found.append(f"{name.removeprefix('pmfid_')} {grew}")
    return found


def others_unchanged(hall: Hall, since: int = 0) -> tuple[str, bool]:
    """Return the first claim: the estimates of all other axes are unchanged."""
    rows, differ = hall.compared(since)
    return f"{rows} rows of the other axes to the last bit, {differ} differ", rows > 0 and differ == 0


def without_alarm(notices: Sequence[Report]) -> tuple[str, bool]:
    alarms = sum(one["event"] == "alarm" and "silent" not in one for one in notices)
    return f"{alarms} false alarms", alarms == 0
