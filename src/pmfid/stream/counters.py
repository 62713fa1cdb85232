"""Counters for the page, `/metrics` and the log: by name and labels, from any thread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

__all__ = ["Counters"]

#: Sorted pairs of label and value.
Labels = tuple[tuple[str, str], ...]


@dataclass
class Counters:
    """Totals that only grow (`add`) and levels that are set (`put`). Names are Prometheus's, as
    "pmfid_samples_total"; labels are few: sources, sinks, reasons, groups, never axes."""

    _values: dict[tuple[str, Labels], float] = field(default_factory=dict, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)

    def add(self, name: str, amount: float = 1, **labels: str) -> None:
        """Adds to a total."""
        key = name, tuple(sorted(labels.items()))
        with self._lock:
            self._values[key] = self._values.get(key, 0) + amount

    def put(self, name: str, value: float, **labels: str) -> None:
        """Sets a level."""
        with self._lock:
            self._values[name, tuple(sorted(labels.items()))] = value

    def values(self) -> Mapping[tuple[str, Labels], float]:
        """All of them now."""
        with self._lock:
            return dict(self._values)
