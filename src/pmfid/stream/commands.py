"""What people ask of the engine while it runs."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Lock

__all__ = ["Acknowledge", "Command", "Commands", "Refer", "RestartNumbers"]

#: Commands that wait at most, and the longest note [characters].
MOST, LONGEST_NOTE = 1000, 2000


@dataclass(frozen=True)
class Acknowledge:
    """The alarm that was told as the notice of this number is known to people."""

    number: int
    note: str


@dataclass(frozen=True)
class Refer:
    """What the axis is now is normal: deviations count from there."""

    axis: str


@dataclass(frozen=True)
class RestartNumbers:
    """The sender of the axis began anew without an epoch that says so: its next samples are taken as they are."""

    axis: str


Command = Acknowledge | Refer | RestartNumbers


class Commands:
    """Commands on their way to the engine, from any thread. What became of one comes back as a `Notice`."""

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque()
        self._lock = Lock()

    def acknowledge(self, number: int, note: str) -> bool:
        """False where the engine has no room for more at the moment."""
        return self._put(Acknowledge(number, note[:LONGEST_NOTE]))

    def refer(self, axis: str) -> bool:
        """False where the engine has no room for more at the moment."""
        return self._put(Refer(axis))

    def restart_numbers(self, axis: str) -> bool:
        """False where the engine has no room for more at the moment."""
        return self._put(RestartNumbers(axis))

    def _put(self, command: Command) -> bool:
        with self._lock:
            if len(self._waiting) >= MOST:
                return False
            self._waiting.append(command)
            return True

    def take_all(self) -> list[Command]:
        """All that wait, in their order; for the engine."""
        with self._lock:
            found, self._waiting = list(self._waiting), deque()
        return found
