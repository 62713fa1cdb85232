"""Commands of people to the running engine."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Lock

__all__ = ["Acknowledge", "Command", "Commands", "Refer", "RestartNumbers"]

#: Commands that wait at most, and the longest note [characters].
MOST, LONGEST_NOTE = 1000, 2000


@dataclass(frozen=True)
class Acknowledge:
    """Someone has acknowledged the alarm with this notice number."""

    number: int
    note: str


@dataclass(frozen=True)
class Refer:
    """The present parameters of the axis become its reference."""

    axis: str


@dataclass(frozen=True)
class RestartNumbers:
    """The sender of the axis restarted without a higher epoch: its next samples are taken whatever their numbers."""

    axis: str


Command = Acknowledge | Refer | RestartNumbers


class Commands:
    """Commands on their way to the engine, from any thread. A `Notice` reports the result of each."""

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque()
        self._lock = Lock()

    def acknowledge(self, number: int, note: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(Acknowledge(number, note[:LONGEST_NOTE]))

    def refer(self, axis: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(Refer(axis))

    def restart_numbers(self, axis: str) -> bool:
        """False if the queue of commands is full."""
        return self._put(RestartNumbers(axis))

    def _put(self, command: Command) -> bool:
        with self._lock:
            if len(self._waiting) >= MOST:
                return False
            self._waiting.append(command)
            return True

    def take_all(self) -> list[Command]:
        """Removes and returns all waiting commands, in order; for the engine."""
        with self._lock:
            commands, self._waiting = list(self._waiting), deque()
        return commands
