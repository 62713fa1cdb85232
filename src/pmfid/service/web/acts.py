"""Commands of the page to the engine."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Acts"]


class Acts(Protocol):
    """No command waits; each returns False if the queue of commands is full. A `Notice` reports its result:
    "acknowledged" with "alarm" (the number) and "note", "reference", or the event of `restart_numbers`."""

    def acknowledge(self, number: int, note: str) -> bool:
        """Acknowledges the alarm with this notice number."""
        ...

    def refer(self, axis: str) -> bool:
        """Makes the present parameters of the axis its reference."""
        ...

    def restart_numbers(self, axis: str) -> bool:
        """Has the next samples of the axis taken whatever their numbers."""
        ...
