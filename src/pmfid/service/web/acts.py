"""What the page may ask of the engine."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Acts"]


class Acts(Protocol):
    """Each is False where the engine has no room for more at the moment, and neither waits. What became of it comes
    back as a `Notice` ("acknowledged" with "alarm": its number and "note"; "reference"; "anew")."""

    def acknowledge(self, number: int, note: str) -> bool:
        """The alarm that was told as the notice of this number is known to people."""
        ...

    def refer(self, axis: str) -> bool:
        """What the axis is now is normal: deviations count from there."""
        ...

    def restart_numbers(self, axis: str) -> bool:
        """The next samples of the axis are taken whatever their numbers."""
        ...
