"""The queue of a sink in bounded memory: the oldest rows are dropped first, alarms last. No threads, no locks."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["MOST_ENTRIES", "URGENT", "Entry", "Lost", "OutcomeQueue", "QueueLimits", "is_urgent"]

#: Events that a person waits for; all others are dropped before them.
URGENT = frozenset({"alarm", "acknowledged", "settled", "cleared"})
#: Most outcomes that are taken at once.
MOST_ENTRIES = 1024


@dataclass(frozen=True)
class QueueLimits:
    """How much may wait for one sink: rows, bytes of rows, notices, each at least 1; take: rows that are handed to the
    sink at once."""

    rows: int = 100_000
    size: int = 64_000_000
    notices: int = 10_000
    take: int = 20_000


class Lost(NamedTuple):
    """Dropped outcomes: the number of rows and of notices; urgent: numbers of the urgent notices among them."""

    rows: int = 0
    notices: int = 0
    urgent: tuple[int, ...] = ()


class Entry(NamedTuple):
    """An outcome that waits; serial: its place in the order in which they came; rows, size [bytes]: 0 for a notice."""

    serial: int
    outcome: EstimateRows | Notice
    rows: int = 0
    size: int = 0


Line = deque[Entry]


def is_urgent(notice: Notice) -> bool:
    """Whether a person waits for it."""
    return notice.what.get("event") in URGENT


def size_of(rows: EstimateRows) -> int:
    """Bytes of the arrays."""
    arrays = (rows.axis, rows.number, rows.time, rows.u, rows.counts, rows.theta, rows.std)
    return sum(array.nbytes for array in (*arrays, rows.innovation, rows.status, rows.state))


@dataclass
class OutcomeQueue:
    """Rows, urgent notices and other ones, each in a line of its own, and taken in the order in which they came.

    What is newest always stays: a single block of rows beyond the limits is kept until the next one comes.
    """

    limits: QueueLimits
    rows: int = field(default=0, init=False)
    size: int = field(default=0, init=False)
    _serial: int = field(default=0, init=False)
    _rows: Line = field(default_factory=deque, init=False)
    _urgent: Line = field(default_factory=deque, init=False)
    _other: Line = field(default_factory=deque, init=False)

    @property
    def notices(self) -> int:
        """How many wait."""
        return len(self._urgent) + len(self._other)

    def __bool__(self) -> bool:
        return bool(self._rows or self._urgent or self._other)

    @property
    def crowded(self) -> bool:
        """Whether one of the limits is half used up."""
        limits = self.limits
        return 2 * self.rows > limits.rows or 2 * self.size > limits.size or 2 * self.notices > limits.notices

    def add(self, outcome: EstimateRows | Notice) -> Lost:
        """Appends an outcome. Returns the dropped outcomes."""
        self._serial += 1
        if isinstance(outcome, EstimateRows):
            self._add_rows(Entry(self._serial, outcome, outcome.axis.size, size_of(outcome)))
        else:
            self._line_of(outcome).append(Entry(self._serial, outcome))
        return self._drop_excess()

    def take(self, most: int = MOST_ENTRIES) -> list[Entry]:
        """The oldest, in order, as many as the limits let a sink have at once, and no more than `most`."""
        taken: list[Entry] = []
        rows = 0
        lines = (self._rows, self._urgent, self._other)
        while len(taken) < most and rows < self.limits.take:
            line = min((line for line in lines if line), key=lambda line: line[0].serial, default=None)
            if line is None:
                break
            taken.append(line.popleft())
            rows += taken[-1].rows
        self.rows -= rows
        self.size -= sum(entry.size for entry in taken)
        return taken

    def give_back(self, taken: Sequence[Entry]) -> Lost:
        """Puts the last taken outcomes in front again. Returns the dropped outcomes."""
        for entry in reversed(taken):
            if isinstance(entry.outcome, EstimateRows):
                self._add_rows(entry, front=True)
            else:
                self._line_of(entry.outcome).appendleft(entry)
        return self._drop_excess()

    def _line_of(self, notice: Notice) -> Line:
        return self._urgent if is_urgent(notice) else self._other

    def _add_rows(self, entry: Entry, front: bool = False) -> None:
        self.rows += entry.rows
        self.size += entry.size
        if front:
            self._rows.appendleft(entry)
        else:
            self._rows.append(entry)

    def _drop_excess(self) -> Lost:
        rows = notices = 0
        urgent: list[int] = []
        while len(self._rows) > 1 and (self.rows > self.limits.rows or self.size > self.limits.size):
            gone = self._rows.popleft()
            self.rows -= gone.rows
            self.size -= gone.size
            rows += gone.rows
        while self.notices > max(self.limits.notices, 1):
            outcome = (self._other or self._urgent).popleft().outcome
            notices += 1
            if isinstance(outcome, Notice) and is_urgent(outcome):
                urgent.append(outcome.number)
        return Lost(rows, notices, tuple(urgent))
