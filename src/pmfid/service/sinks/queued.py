"""Queues of sinks, which keep, repeat or drop outcomes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Condition, Event, Thread
from typing import NamedTuple

import numpy as np
from pydantic import Field

from pmfid.config.toml_file import FileSection
from pmfid.errors import PmfidError, printable
from pmfid.service.context import Context, Sink, Tell
from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import Counters, EstimateRows, Notice

#: Events that a person waits for. All other events are dropped first.
URGENT = frozenset({"alarm", "acknowledged", "settled", "cleared"})
#: Largest number of outcomes that are taken together.
MOST_ENTRIES = 1024


@dataclass(frozen=True)
class QueueLimits:
    """Limits of a sink's queue, each at least 1, as numbers of rows and notices and as bytes of rows.

    `take` is the number of rows that the sink gets together.
    """

    rows: int = 100_000
    size: int = 64_000_000
    notices: int = 10_000
    take: int = 20_000


class Lost(NamedTuple):
    """Numbers of dropped rows and notices. `urgent` has the numbers of dropped urgent notices."""

    rows: int = 0
    notices: int = 0
    urgent: tuple[int, ...] = ()


class Entry(NamedTuple):
    """A waiting outcome.

    `serial` is the place of the outcome in the order of arrival. `rows` and `size` [bytes] are 0 for a notice.
    """

    serial: int
    outcome: EstimateRows | Notice
    rows: int = 0
    size: int = 0


Line = deque[Entry]


def is_urgent(notice: Notice) -> bool:
    """Return whether a person waits for the outcome."""
    return notice.what.get("event") in URGENT


def size_of(rows: EstimateRows) -> int:
    return sum(value.nbytes for value in vars(rows).values() if isinstance(value, np.ndarray))


@dataclass
class OutcomeQueue:
    """A queue with separate lines for rows, urgent notices and other notices, which are taken in the order of arrival.

    The newest block of rows always stays, even above the limits, until the next block arrives.
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
        return len(self._urgent) + len(self._other)

    def __bool__(self) -> bool:
        return bool(self._rows or self._urgent or self._other)

    @property
    def crowded(self) -> bool:
        """Whether one of the limits is half used up."""
        limits = self.limits
        return 2 * self.rows > limits.rows or 2 * self.size > limits.size or 2 * self.notices > limits.notices

    def add(self, outcome: EstimateRows | Notice) -> Lost:
        """Append an outcome, and return the dropped outcomes."""
        self._serial += 1
        if isinstance(outcome, EstimateRows):
            entry = Entry(self._serial, outcome, outcome.axis.size, size_of(outcome))
        else:
            entry = Entry(self._serial, outcome)
        self._count(entry).append(entry)
        return self._drop_excess()

    def take(self, most: int = MOST_ENTRIES) -> list[Entry]:
        """Return the oldest outcomes, in order, at most `most`, and within the limits of a sink."""
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
        """Put the last taken outcomes in front again, and return the dropped outcomes."""
        for entry in reversed(taken):
            self._count(entry).appendleft(entry)
        return self._drop_excess()

    def _count(self, entry: Entry) -> Line:
        """Count an entry, and return its line."""
        self.rows += entry.rows
        self.size += entry.size
        if isinstance(entry.outcome, EstimateRows):
            return self._rows
        return self._urgent if is_urgent(entry.outcome) else self._other

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


def problem_of(error: Exception) -> str:
    """Return the problem as one line.

    A system error gives the words for its number, without addresses that may contain a secret.
    """
    if isinstance(error, OSError) and error.strerror:
        name = f": {error.filename}" if isinstance(error.filename, str) else ""
        return printable(f"{error.strerror}{name}")
    text = " ".join(str(error).split()) or type(error).__name__
    return printable(text if isinstance(error, OSError | PmfidError) else f"{type(error).__name__}: {text}")


class Queued:
    """An outlet that keeps outcomes until the sink has them.

    An offer takes microseconds, because no write and no comparison holds the lock. After an OSError of the sink, the
    outcomes are tried again with growing pauses, each time after `open`. The error is reported once. After another
    error the outcomes are tried one by one. An outcome that causes the error again is dropped. Levels and totals have
    the label `sink`: pmfid_sink_waiting_rows, pmfid_sink_working, pmfid_sink_rows_total, pmfid_sink_errors_total,
    pmfid_dropped_rows_total, pmfid_dropped_notices_total, pmfid_refused_total.

    `rows_wanted` is true if this sink takes rows. `events` has the notices for this sink. None means all notices.
    """

    def __init__(
        self,
        sink: Sink,
        counters: Counters,
        tell: Tell,
        limits: QueueLimits | None = None,
        rows_wanted: bool = True,
        events: frozenset[str] | None = None,
    ) -> None:
        self.name = sink.name
        self._sink, self._counters, self._tell = sink, counters, tell
        self._limits = limits or QueueLimits()
        self._rows_wanted, self._events = rows_wanted, events
        self._waiting = OutcomeQueue(self._limits)
        self._changed, self._closing = Condition(), Event()
        self._deadline = float("inf")  # deadline of `close`
        self._open = self._failing = False
        self._pause, self._working_since, self._taken_at = 0.0, 0.0, -TUNING.queued_idle
        self._alone = 0  # number of next outcomes that are written one by one
        self._lost = Lost()  # dropped rows and notices without a report
        self._reported_at = -TUNING.tell_every
        self._refusals: set[str] = set()
        self._trying: float | None = None  # time since which the sink has taken nothing
        self._proved = False  # true if the sink has taken something
        self._unwritten: dict[int, Notice] = {}  # urgent notices that the sink does not have yet, by number
        self._thread = Thread(target=self._run, name=f"sink {sink.name}", daemon=True)
        for total in ("pmfid_dropped_rows_total", "pmfid_dropped_notices_total", "pmfid_sink_errors_total"):
            counters.add(total, 0, sink=self.name)
        counters.put("pmfid_sink_working", 1, sink=self.name)

    # --- the engine's side --------------------------------------------------------------------------------------------

    def rows(self, rows: EstimateRows) -> None:
        if self._rows_wanted and rows.axis.size:
            self._offer(rows)

    def notice(self, notice: Notice) -> None:
        if self._events is None or notice.what.get("event") in self._events:
            self._offer(notice)

    def _offer(self, outcome: EstimateRows | Notice) -> None:
        with self._changed:
            first = not self._waiting
            if isinstance(outcome, Notice) and is_urgent(outcome):
                self._unwritten[outcome.number] = outcome
            lost = self._waiting.add(outcome)
            waiting = self._waiting.rows
            if first or self._waiting.crowded:
                self._changed.notify()
        self._counters.put("pmfid_sink_waiting_rows", waiting, sink=self.name)
        self._count_lost(lost)

    def unwritten(self) -> list[Notice]:
        """Return alarms, and notices on alarms, that the sink does not have yet. A checkpoint keeps these notices."""
        with self._changed:
            return list(self._unwritten.values())

    def works(self, since: float) -> bool | None:
        """Return whether the sink works, or None if unknown. A sink that waits for a silent server does not work."""
        trying = self._trying
        if trying is None:
            return self._proved or None
        return None if trying > since else False

    def _forget_written(self, batch: Sequence[Entry]) -> None:
        """Forget urgent notices that the sink has, or that it refuses."""
        with self._changed:
            for entry in batch:
                if isinstance(entry.outcome, Notice):
                    self._unwritten.pop(entry.outcome.number, None)

    def start(self) -> None:
        self._thread.start()

    def close(self, within: float) -> bool:
        """Let the sink write the waiting outcomes for at most `within` seconds, then drop and count the remaining
        outcomes.

        Returns False if the sink has not ended by then.
        """
        with self._changed:
            self._deadline = time.monotonic() + within
            self._closing.set()
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join(within)
        ended = not self._thread.is_alive()
        with self._changed:
            lost = Lost(self._waiting.rows, self._waiting.notices)
            self._waiting = OutcomeQueue(self._limits)
        self._count_lost(lost)
        return ended

    def _count_lost(self, lost: Lost) -> None:
        if lost.rows:
            self._counters.add("pmfid_dropped_rows_total", lost.rows, sink=self.name)
        if lost.notices:
            self._counters.add("pmfid_dropped_notices_total", lost.notices, sink=self.name)
        if any(lost):
            with self._changed:
                self._lost = Lost(self._lost.rows + lost.rows, self._lost.notices + lost.notices)
                for number in lost.urgent:
                    self._unwritten.pop(number, None)

    # --- the sink's thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while (batch := self._next()) is not None:
            self._write(batch)
            self._tell_lost()
            self._counters.put("pmfid_sink_waiting_rows", self._waiting.rows, sink=self.name)
            if self._failing and self._closing.is_set():
                break
            if self._failing:
                self._closing.wait(self._pause)
        self._end()

    def _next(self) -> list[Entry] | None:
        """Wait for the next outcomes, and return them, or None at the end.

        After `queued_idle`, the result is an empty list.
        """
        with self._changed:
            while not (self._closing.is_set() or self._waiting.crowded or self._compute_wait() == 0):
                self._changed.wait(self._compute_wait())
            self._taken_at = time.monotonic()
            if self._taken_at >= self._deadline or (self._closing.is_set() and not self._waiting):
                return None
            return self._waiting.take(1 if self._alone else MOST_ENTRIES)

    def _compute_wait(self) -> float:
        """Return the seconds until the sink has outcomes to write, or until it is to be checked."""
        return 0.0 if self._alone or self._waiting else max(self._taken_at + TUNING.queued_idle - time.monotonic(), 0.0)

    def _write(self, batch: Sequence[Entry]) -> None:
        if batch and self._trying is None:
            self._trying = time.monotonic()
        try:
            if not self._open:
                self._sink.open()
                self._open = True
            self._sink.put([entry.outcome for entry in batch])
        except Exception as error:
            if self._open and batch and not isinstance(error, OSError):
                self._drop_refused(error, batch)
            else:
                self._note_failure(error, batch)
        else:
            self._note_success(batch)

    def _note_success(self, batch: Sequence[Entry]) -> None:
        self._forget_written(batch)
        if batch or self._failing:
            self._trying, self._proved = None, True
        self._alone = max(self._alone - 1, 0)
        self._counters.add("pmfid_sink_rows_total", sum(entry.rows for entry in batch), sink=self.name)
        if self._failing:
            self._failing, self._working_since = False, time.monotonic()
            self._counters.put("pmfid_sink_working", 1, sink=self.name)
            with self._changed:
                lost, self._lost = self._lost, Lost()
            recovery = {"event": "sink", "sink": self.name, "works": True}
            self._tell({**recovery, "lost_rows": lost.rows, "lost_notices": lost.notices})

    def _note_failure(self, error: Exception, batch: Sequence[Entry]) -> None:
        """Report a passing error once. The outcomes wait in front of all others."""
        steady = not self._failing and time.monotonic() - self._working_since > TUNING.queued_steady
        again = min(2 * self._pause, TUNING.queued_longest_pause)
        self._pause = TUNING.queued_first_pause if steady or not self._pause else again
        self._counters.add("pmfid_sink_errors_total", sink=self.name)
        if self._trying is None:
            self._trying = time.monotonic()
        if not self._failing:
            self._counters.put("pmfid_sink_working", 0, sink=self.name)
            self._tell({"event": "sink", "sink": self.name, "works": False, "problem": problem_of(error)})
        self._open, self._failing = False, True
        self._give_back(batch)

    def _give_back(self, batch: Sequence[Entry]) -> None:
        with self._changed:
            lost = self._waiting.give_back(batch)
        self._count_lost(lost)

    def _drop_refused(self, error: Exception, batch: Sequence[Entry]) -> None:
        """Try the outcomes one by one after a lasting error, and drop the outcome that causes the error."""
        if len(batch) > 1:
            self._alone = len(batch)
            self._give_back(batch)
            return
        self._forget_written(batch)
        self._alone = max(self._alone - 1, 0)
        self._counters.add("pmfid_refused_total", max(batch[0].rows, 1), sink=self.name)
        problem = problem_of(error)
        if problem not in self._refusals and len(self._refusals) < TUNING.most_refusals:
            self._refusals.add(problem)
            self._tell({"event": "sink", "sink": self.name, "works": True, "problem": f"refused: {problem}"})

    def _tell_lost(self) -> None:
        """Report a slow sink. At the end of an error, the report on the error contains its own losses."""
        if self._failing or not any(self._lost) or time.monotonic() - self._reported_at < TUNING.tell_every:
            return
        self._reported_at = time.monotonic()
        with self._changed:
            lost, self._lost = self._lost, Lost()
        self._tell({"event": "dropped", "sink": self.name, "rows": lost.rows, "notices": lost.notices})

    def _end(self) -> None:
        try:
            self._sink.close()
        except Exception as error:
            self._counters.add("pmfid_sink_errors_total", sink=self.name)
            self._tell({"event": "sink", "sink": self.name, "works": False, "problem": problem_of(error)})


class SinkSection(FileSection):
    """Keys that every [sinks.NAME] may have."""

    queue_rows: int = Field(
        100_000, ge=1, description="the largest number of waiting rows; beyond it the oldest rows are dropped"
    )
    queue_mb: float = Field(64.0, gt=0, description="the largest size of the waiting rows in MB, for example 64.0")
    queue_notices: int = Field(10_000, ge=1, description="the largest number of waiting notices")

    def make(self, name: str, context: Context) -> Sink:
        """Return the sink, not yet open.

        Raises UsageError for errors that are known before, for example a missing library or secret.
        """
        raise NotImplementedError

    def wants_rows(self) -> bool:
        return True

    def wants_events(self) -> frozenset[str] | None:
        """Return the events for this sink, or None for all events."""
        return None

    def outlet(self, name: str, context: Context) -> Queued:
        """Return the queue of the sink, not yet started. Raises UsageError as `make` does."""
        limits = QueueLimits(self.queue_rows, int(1e6 * self.queue_mb), self.queue_notices)
        sink = self.make(name, context)
        return Queued(sink, context.counters, context.tell, limits, self.wants_rows(), self.wants_events())
