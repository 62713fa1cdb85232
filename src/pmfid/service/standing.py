"""A process that was stopped and goes on says so: nothing else would tell why its estimates came late."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from pmfid.service.counters import Counters

__all__ = ["Standing"]

#: A process that has not come by for so long was stopped [s]: no load keeps it away.
STOOD = 10.0


@dataclass
class Standing:
    """To be called again and again: tells how long the whole process stood still."""

    tell: Callable[[dict[str, Any]], None]
    counters: Counters
    _looked: float = field(default_factory=monotonic, init=False)

    def look(self) -> None:
        """Now."""
        now = monotonic()
        stood, self._looked = now - self._looked, now
        if stood > STOOD:
            problem = f"the service stood still for {stood:.0f} s: it was stopped, or its machine had no time for it"
            self.tell({"event": "paused", "seconds": round(stood, 1), "problem": problem})
            self.counters.add("pmfid_paused_seconds_total", stood)
