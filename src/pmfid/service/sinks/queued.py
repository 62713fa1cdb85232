"""Queues of sinks, which keep, repeat or drop outcomes."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from threading import Condition, Event, Thread
from typing import ClassVar, NamedTuple

import numpy as np

from pmfid.config.toml_file import FileSection
from pmfid.errors import PmfidError, printable
from pmfid.service.broker import pauses
from pmfid.service.context import Context, Outcome, Sink, Tell
from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import Counters, EstimateRows, Notice
from pmfid.stream.tuning import TUNING as STREAM_TUNING


class QueueLimits(NamedTuple):
    """Largest size of the waiting rows [bytes], largest number of waiting notices, and number of outcomes that the sink
    gets together."""

    size: int = 64_000_000
    notices: int = 10_000
    take: int = 1024


#: Numbers of dropped "rows" and "notices".
Lost = Counter[str]


def size_of(rows: EstimateRows) -> int:
    return sum(value.nbytes for value in vars(rows).values() if isinstance(value, np.ndarray))


def rows_in(outcomes: Iterable[Outcome]) -> int:
    """Return the number of rows in the outcomes."""
    return sum(one.axis.size for one in outcomes if isinstance(one, EstimateRows))


class OutcomeQueue:
    """A queue of notices and a queue of rows, each bounded. Notices are taken first.

    The newest block of rows always stays, even above the limit, until the next block arrives.
    """

    def __init__(self, limits: QueueLimits) -> None:
        self.limits, self.size, self.waiting_rows = limits, 0, 0
        self.rows, self.notices = deque[EstimateRows](), deque[Notice]()

    def __bool__(self) -> bool:
        return bool(self.rows or self.notices)

    def add(self, outcome: Outcome) -> Lost:
        """Append an outcome, and return the dropped outcomes."""
        if isinstance(outcome, Notice):
            self.notices.append(outcome)
        else:
            self.rows.append(outcome)
            self._count(outcome, 1)
        return self._drop_excess()

    def take(self, most: float = math.inf) -> list[Outcome]:
        """Return at most `most` outcomes, of each kind the oldest in order."""
        taken: list[Outcome] = []
        while self and len(taken) < most:
            taken.append(self.notices.popleft() if self.notices else self._pop_rows())
        return taken

    def _pop_rows(self) -> EstimateRows:
        rows = self.rows.popleft()
        self._count(rows, -1)
        return rows

    def _count(self, rows: EstimateRows, sign: int) -> None:
        self.size += sign * size_of(rows)
        self.waiting_rows += sign * rows.axis.size

    def give_back(self, taken: Sequence[Outcome]) -> Lost:
        """Put the last taken outcomes in front again, and return the dropped outcomes."""
        for outcome in reversed(taken):
            if isinstance(outcome, Notice):
                self.notices.appendleft(outcome)
            else:
                self.rows.appendleft(outcome)
                self._count(outcome, 1)
        return self._drop_excess()

    def _drop_excess(self) -> Lost:
        lost = Lost()
        while len(self.rows) > 1 and self.size > self.limits.size:
            lost["rows"] += self._pop_rows().axis.size
        while len(self.notices) > self.limits.notices:
            del self.notices[next((k for k, one in enumerate(self.notices) if not one.urgent), 0)]
            lost["notices"] += 1
        return lost


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

    """

    def __init__(self, sink: Sink, counters: Counters, tell: Tell, limits: QueueLimits | None = None) -> None:
        self.name = sink.name
        self._sink, self._counters, self._tell = sink, counters, tell
        self._limits = limits or QueueLimits()
        self._waiting = OutcomeQueue(self._limits)
        self._batch: Sequence[Outcome] = ()  # outcomes that the sink is writing
        self._changed, self._closing = Condition(), Event()
        self._deadline = float("inf")  # deadline of `close`
        self._open = self._failing = False
        self._pauses, self._working_since, self._taken_at = pauses(), 0.0, -TUNING.queued_idle
        self._alone = 0  # number of next outcomes that are written one by one
        self._lost = Lost()  # dropped rows and notices without a report
        self._reported_at = -TUNING.longest_pause
        self._refusals: set[str] = set()
        self._trying: float | None = None  # time since which the sink has taken nothing
        self._proved = False  # true if the sink has taken something
        self._thread = Thread(target=self._run, name=f"sink {sink.name}", daemon=True)
        for total in ("pmfid_dropped_rows_total", "pmfid_dropped_notices_total", "pmfid_sink_errors_total"):
            counters.add(total, 0, sink=self.name)
        counters.put("pmfid_sink_working", 1, sink=self.name)

    # --- the engine's side --------------------------------------------------------------------------------------------

    def rows(self, rows: EstimateRows) -> None:
        if self._sink.takes_rows and rows.axis.size:
            self._offer(rows)

    def notice(self, notice: Notice) -> None:
        if self._sink.events is None or notice.what.get("event") in self._sink.events:
            self._offer(notice)

    def _offer(self, outcome: Outcome) -> None:
        with self._changed:
            if not self._waiting:
                self._changed.notify()
            self._count_lost(self._waiting.add(outcome))
            waiting = self._waiting.waiting_rows
        self._counters.put("pmfid_sink_waiting_rows", waiting, sink=self.name)

    def unwritten(self) -> list[Notice]:
        """Return alarms, and notices on alarms, that the sink does not have yet. A checkpoint keeps these notices."""
        with self._changed:
            known = (*self._batch, *self._waiting.notices)
            return [one for one in known if isinstance(one, Notice) and one.urgent]

    def works(self, since: float) -> bool | None:
        """Return whether the sink works, or None if unknown. A sink that waits for a silent server does not work."""
        trying = self._trying
        if trying is None:
            return self._proved or None
        return None if trying > since else False

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
            self._count_lost(Lost(rows=self._waiting.waiting_rows, notices=len(self._waiting.notices)))
        return ended

    def _count_lost(self, lost: Lost) -> None:
        for kind, number in lost.items():
            self._counters.add(f"pmfid_dropped_{kind}_total", number, sink=self.name)
        self._lost += lost

    # --- the sink's thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while (batch := self._next()) is not None:
            self._write(batch)
            self._tell_lost()
            self._counters.put("pmfid_sink_waiting_rows", self._waiting.waiting_rows, sink=self.name)
            if self._failing and self._closing.is_set():
                break
            if self._failing:
                self._closing.wait(next(self._pauses))
        self._end()

    def _next(self) -> Sequence[Outcome] | None:
        """Wait for the next outcomes, and return them, or None at the end.

        After `queued_idle`, the result is an empty list.
        """
        with self._changed:
            idle = max(self._taken_at + TUNING.queued_idle - time.monotonic(), 0.0)
            self._changed.wait_for(lambda: self._waiting or self._closing.is_set(), idle)
            self._taken_at = time.monotonic()
            if self._taken_at >= self._deadline or (self._closing.is_set() and not self._waiting):
                return None
            self._batch = self._waiting.take(1 if self._alone else self._limits.take)
            return self._batch

    def _write(self, batch: Sequence[Outcome]) -> None:
        if batch and self._trying is None:
            self._trying = time.monotonic()
        try:
            if not self._open:
                self._sink.open()
                self._open = True
            self._sink.put(list(batch))
        except Exception as error:
            if self._open and batch and not isinstance(error, OSError):
                self._drop_refused(error, batch)
            else:
                self._note_failure(error, batch)
        else:
            self._note_success(batch)

    def _note_success(self, batch: Sequence[Outcome]) -> None:
        self._batch = ()
        if batch or self._failing:
            self._trying, self._proved = None, True
        self._alone = max(self._alone - 1, 0)
        self._counters.add("pmfid_sink_rows_total", rows_in(batch), sink=self.name)
        if self._failing:
            self._failing, self._working_since = False, time.monotonic()
            self._counters.put("pmfid_sink_working", 1, sink=self.name)
            with self._changed:
                lost, self._lost = self._lost, Lost()
            recovery = {"event": "sink", "sink": self.name, "works": True}
            self._tell({**recovery, "lost_rows": lost["rows"], "lost_notices": lost["notices"]})

    def _note_failure(self, error: Exception, batch: Sequence[Outcome]) -> None:
        """Report a passing error once. The outcomes wait in front of all others."""
        if not self._failing and time.monotonic() - self._working_since > TUNING.longest_pause:
            self._pauses = pauses()
        self._counters.add("pmfid_sink_errors_total", sink=self.name)
        if self._trying is None:
            self._trying = time.monotonic()
        if not self._failing:
            self._counters.put("pmfid_sink_working", 0, sink=self.name)
            self._tell({"event": "sink", "sink": self.name, "works": False, "problem": problem_of(error)})
        self._open, self._failing = False, True
        self._give_back(batch)

    def _give_back(self, batch: Sequence[Outcome]) -> None:
        with self._changed:
            self._batch = ()
            self._count_lost(self._waiting.give_back(batch))

    def _drop_refused(self, error: Exception, batch: Sequence[Outcome]) -> None:
        """Try the outcomes one by one after a lasting error, and drop the outcome that causes the error."""
        if len(batch) > 1:
            self._alone = len(batch)
            self._give_back(batch)
            return
        self._batch = ()
        self._alone = max(self._alone - 1, 0)
        self._counters.add("pmfid_refused_total", max(rows_in(batch), 1), sink=self.name)
        problem = problem_of(error)
        if problem not in self._refusals and len(self._refusals) < STREAM_TUNING.each_notice:
            self._refusals.add(problem)
            self._tell({"event": "sink", "sink": self.name, "works": True, "problem": f"refused: {problem}"})

    def _tell_lost(self) -> None:
        """Report a slow sink. At the end of an error, the report on the error contains its own losses."""
        if self._failing or not self._lost or time.monotonic() - self._reported_at < TUNING.longest_pause:
            return
        self._reported_at = time.monotonic()
        with self._changed:
            lost, self._lost = self._lost, Lost()
        self._tell({"event": "dropped", "sink": self.name, "rows": lost["rows"], "notices": lost["notices"]})

    def _end(self) -> None:
        try:
            self._sink.close()
        except Exception as error:
            self._counters.add("pmfid_sink_errors_total", sink=self.name)
            self._tell({"event": "sink", "sink": self.name, "works": False, "problem": problem_of(error)})


class SinkSection(FileSection):
    """[sinks.NAME] of any kind. `limits` belong to the queue of the sink."""

    limits: ClassVar[QueueLimits] = QueueLimits()

    def make(self, name: str, context: Context) -> Sink:
        """Return the sink, not yet open.

        Raises UsageError for errors that are known before, for example a missing library or secret.
        """
        raise NotImplementedError
