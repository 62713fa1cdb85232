"""Every row of one axis for someone who looks at it: bounded, the oldest dropped and counted."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Lock

import numpy as np

from pmfid.service.board.panel import Records

__all__ = ["Subscription"]


class Subscription:
    """axis: its name; most: rows that wait at most; close: called once when nobody looks any more."""

    def __init__(self, axis: str, most: int, close: Callable[[Subscription], None]) -> None:
        self.axis, self._most, self._close = axis, most, close
        self._pieces: deque[Records] = deque()
        self._waiting = 0
        self._dropped = 0
        self._lock = Lock()

    def put(self, rows: Records) -> int:
        """By the engine's thread: never waits for a reader, who holds the lock for the swap of a list only. Returns the
        rows that had to go."""
        with self._lock:
            self._pieces.append(rows)
            self._waiting += rows.size
            dropped = 0
            while self._waiting > self._most and len(self._pieces) > 1:
                gone = self._pieces.popleft().size
                self._waiting -= gone
                dropped += gone
            self._dropped += dropped
        return dropped

    def take(self) -> tuple[Records | None, int]:
        """What came since the last time, None for nothing, and how many rows were dropped meanwhile."""
        with self._lock:
            pieces, self._pieces = self._pieces, deque()
            dropped, self._dropped, self._waiting = self._dropped, 0, 0
        if not pieces:
            return None, dropped
        kinds = {piece.dtype for piece in pieces}
        last = pieces[-1].dtype  # a changed configuration may have other parameters: what was before is history
        same = [piece for piece in pieces if piece.dtype == last] if len(kinds) > 1 else list(pieces)
        return np.concatenate(same), dropped

    def close(self) -> None:
        """Nobody looks any more. May be called twice."""
        self._close(self)
