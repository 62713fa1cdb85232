"""Checkpoints of states and notices, for which the engine copies its states and another thread writes the copies."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from pmfid.durable import crash_point
from pmfid.service.sinks.queued import Lost, OutcomeQueue, QueueLimits
from pmfid.service.tuning import TUNING
from pmfid.stream.checkpoint import Draft, draft
from pmfid.stream.engine import StreamEngine
from pmfid.stream.outcome import Counters, EstimateRows, Notice
from pmfid.stream.store import Vault

Done = Callable[[], object]


@dataclass
class Checkpoints:
    """A `Keeper` that writes checkpoints to the disk.

    This outlet keeps the notices for the next checkpoint, so that a restart neither loses nor repeats a notice on
    repeated data. `period` is the time between two checkpoints [s], which is longer if writing takes long. `tell`
    receives notices on the disk. Until `begun` is set, the engine has no states to write. If the disk fails or is too
    slow, deliveries are acknowledged without a checkpoint. Waiting for the disk would stop source and monitoring. A
    notice reports this state, and the checkpoint that a restart would use.
    """

    vault: Vault
    period: float
    counters: Counters
    tell: Callable[[dict[str, Any]], None]
    begun: bool = False
    _undone: list[Done] = field(default_factory=list, init=False)
    _notices: OutcomeQueue = field(default_factory=lambda: OutcomeQueue(QueueLimits()), init=False)
    _job: Future[bool] | None = field(default=None, init=False)
    _failing: bool = field(default=False, init=False)
    _too_slow: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._next, self._rested, self._made_at = monotonic() + self.period, 0.0, -1
        self._batch, self._urgent = list[Notice](), False
        self._writer = ThreadPoolExecutor(1, "checkpoints")

    def rows(self, rows: EstimateRows) -> None:
        """Leave rows to the sinks."""

    def notice(self, notice: Notice) -> None:
        """Keep a notice for the next checkpoint, which is due at once for an urgent one."""
        self._urgent |= notice.urgent
        self._count_lost(self._notices.add(notice))

    def _count_lost(self, lost: Lost) -> None:
        if lost["notices"]:
            self.counters.add("pmfid_dropped_notices_total", lost["notices"], sink="history")

    def call_when_kept(self, done: Done) -> None:
        """Register `done`, which is called after the next durable checkpoint."""
        self._undone.append(done)
        if not self._failing and len(self._undone) <= TUNING.keeping_most:
            return
        if not self._failing and not self._too_slow:
            self._too_slow = True
            problem = "the disk is too slow: the service now acknowledges data before a checkpoint contains them"
            self.tell({"event": "checkpoint", "problem": problem})
        self._call(self._undone)
        self._undone = []

    def offer(self, engine: StreamEngine, last: bool = False) -> None:
        """Make a checkpoint if one is due, anything has changed, and the last checkpoint is written.

        If `last` is set, the checkpoint is made immediately, and the call returns after the attempt to write it.
        """
        due = 0.0 if self._urgent else self._next
        if self._job is not None and (last or self._job.done()):
            if not self._job.result():
                self._count_lost(self._notices.give_back(self._batch))
            self._job = None
        if last:
            self._make(engine).result()
            self._writer.shutdown()
            self.vault.close()
        elif self._job is None and self.begun and (engine.urgent or monotonic() >= max(self._rested, due)):
            self._next = monotonic() + self.period
            if engine.changes != self._made_at or self._notices:
                self._make(engine)

    def _make(self, engine: StreamEngine) -> Future[bool]:
        begun = monotonic()
        # The next checkpoint writes the outcomes that wait for a sink, even if nothing else changes.
        self._made_at, engine.urgent = -1 if any(engine.unwritten().values()) else engine.changes, False
        self._batch, self._urgent = [one for one in self._notices.take() if isinstance(one, Notice)], False
        made, done = None, list[Done]()
        if self.begun:
            made, done, self._undone = draft(engine), self._undone, []
        crash_point("checkpoint.made")
        self.counters.put("pmfid_checkpoint_made_seconds", monotonic() - begun)
        self._job = self._writer.submit(self._write, made, self._batch, done)
        return self._job

    # --- the writer's thread ------------------------------------------------------------------------------------------

    def _write(self, made: Draft | None, notices: list[Notice], done: list[Done]) -> bool:
        """Return whether states and notices are on the disk."""
        begun = monotonic()
        try:
            chunks = [] if made is None else made.chunks()
            self.counters.put("pmfid_checkpoint_bytes", sum(map(len, chunks)))
            self.vault.write(chunks, notices)
        except OSError as error:
            self._note_failure(error)
        else:
            self._note_success(monotonic() - begun)
        self._rested = monotonic() + TUNING.keeping_rest * (monotonic() - begun)
        self._call(done)
        return not self._failing

    def _note_failure(self, error: OSError) -> None:
        self.counters.add("pmfid_checkpoint_errors_total")
        self.counters.put("pmfid_checkpoint_working", 0)
        if not self._failing:
            self._failing = True
            reason = error.strerror or str(error)
            problem = (
                f"no checkpoint can be written: {reason}; the service keeps watching and acknowledges data "
                "without a checkpoint, but a restart would go back to the last checkpoint"
            )
            self.tell({"event": "checkpoint", "problem": problem, "last": self.vault.sequence})

    def _note_success(self, seconds: float) -> None:
        self.counters.add("pmfid_checkpoints_total")
        self.counters.put("pmfid_checkpoint_working", 1)
        self.counters.put("pmfid_checkpoint_seconds", seconds)
        self._too_slow = False
        if self._failing:
            self._failing = False
            self.tell({"event": "checkpoint", "works": True, "sequence": self.vault.sequence})

    @staticmethod
    def _call(waiting: list[Done]) -> None:
        if waiting:
            crash_point("ack")
        for done in waiting:
            done()
            crash_point("acked")
