"""The engine, whose thread owns all estimators."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from threading import Condition
from time import monotonic
from typing import Any, Protocol

import numpy as np

from pmfid.durable import crash_point
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.run import event_object
from pmfid.stream.delivery import Delivery
from pmfid.stream.groups import Group, Seat
from pmfid.stream.intake import Intake, Ordered
from pmfid.stream.notices import Notices, Silence
from pmfid.stream.outcome import Counters, Notice, Outlet
from pmfid.stream.stepping import FoundEvent, step
from pmfid.stream.tuning import TUNING


class Inbox:
    """The queue of deliveries. The threads of sources add deliveries, and the engine's thread removes them."""

    def __init__(self) -> None:
        self._waiting: deque[Delivery] = deque()
        self._items = 0
        self._open = True
        self._changed = Condition()
        self._last = 0.0

    def put(self, delivery: Delivery) -> bool:
        """Hand over a delivery, and wait while the inbox is full. A closed inbox refuses the delivery and returns
        False.
        """
        with self._changed:
            while self._open and self._full:
                self._changed.wait()
            if not self._open:
                return False
            self._waiting.append(delivery)
            self._items += delivery.size
            if len(self._waiting) == 1 or self._enough:
                self._changed.notify_all()
        crash_point("inbox.taken")
        return True

    @property
    def _full(self) -> bool:
        return max(len(self._waiting), self._items) >= TUNING.engine_most

    @property
    def _enough(self) -> bool:
        return self._items >= TUNING.at_once or self._full

    def take_deliveries(self, timeout: float) -> list[Delivery]:
        """Return the oldest deliveries, or none after `timeout` [s].

        The earliest time is `engine_tick` after the last deliveries, or as soon as `at_once` items wait.
        """
        with self._changed:
            if not self._waiting and self._open:
                self._changed.wait_for(lambda: self._waiting or not self._open, timeout)
            if self._waiting and self._open and not self._enough:
                rest = self._last + TUNING.engine_tick - monotonic()
                self._changed.wait_for(lambda: self._enough or not self._open, max(0.0, rest))
            deliveries, items = list[Delivery](), 0
            while self._waiting and items < TUNING.at_once:
                deliveries.append(self._waiting.popleft())
                items += deliveries[-1].size
            self._items -= items
            self._changed.notify_all()
        if deliveries:
            self._last = monotonic()
        return deliveries

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether the inbox is closed and empty."""
        return not self._open and not self._waiting

    def close(self) -> None:
        """Refuse further deliveries. Waiting deliveries can still be taken."""
        with self._changed:
            self._open = False
            self._changed.notify_all()


class Keeper(Protocol):
    """An object that writes checkpoints."""

    def offer(self, engine: StreamEngine) -> None:
        """Make a checkpoint between two ticks if one is due."""
        ...

    def call_when_kept(self, done: Callable[[], object]) -> None:
        """Have `done` called once all samples stepped so far are in a durable checkpoint."""
        ...


@dataclass
class StreamEngine:
    """An engine that steps the axes of all groups as deliveries arrive.

    `outlets` receive rows and notices. `followed` returns the names of the axes whose rows are all given out. `groups`
    has all axes. `unwritten` returns the alarms that sinks do not have yet, by the name of the sink. Without a
    `keeper`, deliveries are done when they are stepped.

    `numbered` is the last number given to an axis. `beat` is `time.monotonic()` of the last tick. `changes` counts the
    changes to the content of a checkpoint. If `urgent` is set, a checkpoint is due soon, because no source repeats a
    command. `waiting` is true while no source may deliver, so that silence means nothing.
    """

    counters: Counters
    outlets: Sequence[Outlet] = ()
    followed: Callable[[], frozenset[str]] = frozenset
    inbox: Inbox = field(default_factory=Inbox)
    keeper: Keeper | None = None
    unwritten: Callable[[], dict[str, list[Notice]]] = dict
    groups: list[Group] = field(default_factory=list, init=False)
    numbered: int = field(default=0, init=False)
    beat: float = field(default=0.0, init=False)
    changes: int = field(default=0, init=False)
    urgent: bool = field(default=False, init=False)
    waiting: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.notices = Notices(self.outlets)
        self.silence = Silence(self.notices, self.counters)
        self._intake = Intake(self.counters, lambda what, axis: self.tell(what, axis), self.silence.number_source)
        self._said: deque[tuple[str, dict[str, Any]]] = deque()
        self._asked: deque[tuple[Callable[[], None], bool]] = deque()  # changes, with True if urgent

    # --- from any thread ----------------------------------------------------------------------------------------------

    def tell(self, what: dict[str, Any], axis: str = "") -> None:
        """Make a notice of the service at the next tick. The state of a source is also a gauge."""
        if what.get("event") == "source":
            self.counters.put("pmfid_source_working", float(not what.get("problem")), source=what["source"])
        self._said.append((axis, what))

    def ask(self, change: Callable[[], None]) -> None:
        """Have `change` called by the engine's thread, between two ticks."""
        self._asked.append((change, False))

    def acknowledge(self, number: int, note: str) -> bool:
        """Acknowledge the alarm with this notice number, and return False if too many commands wait.

        A `Notice` reports the result of a command.
        """
        return self._command(partial(self._acknowledge, number, note))

    def refer(self, axis: str) -> bool:
        """Make the present parameters of the axis its reference, and return False if too many commands wait."""
        return self._command(partial(self._refer, axis))

    def restart_numbers(self, axis: str) -> bool:
        """Accept the next samples of the axis with any numbers, and return False if too many commands wait.

        This command helps after a restart of a sender without a higher epoch.
        """
        return self._command(partial(self._restart_numbers, axis))

    def _command(self, change: Callable[[], None]) -> bool:
        if len(self._asked) >= TUNING.commands_most:
            return False
        self._asked.append((change, True))
        return True

    # --- the engine's thread ------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Tick until the inbox is closed and empty."""
        while self.tick(TUNING.engine_idle):
            pass
        self.speak()

    def tick(self, timeout: float) -> bool:
        """Step the waiting deliveries. Returns False once the inbox is closed and empty."""
        batch = self.inbox.take_deliveries(timeout)
        self.beat = monotonic()
        if not self.waiting:
            self.silence.tick(self.beat)
        if batch:
            self.process(batch)
        self._obey()
        if not self.waiting and self.silence.look(self.groups):
            self.changes += 1
            self.urgent = True
        self.speak()
        if self.keeper is not None:
            self.keeper.offer(self)
        return bool(batch) or not self.inbox.closed

    def set_groups(self, groups: Iterable[Group]) -> None:
        self.groups = [group for group in groups if group.seats]
        self._intake.seats = {seat.name: seat for group in self.groups for seat in group.seats}
        for seat in self._intake.seats.values():
            if not seat.number:
                self.numbered += 1
                seat.number = self.numbered
        for group in self.groups:
            self.counters.put("pmfid_axes", len(group.seats), group=group.kindred.config)

    @property
    def awaited(self) -> frozenset[str]:
        """Names of axes that are still being calibrated, whose data are dropped and counted."""
        return self._intake.awaited

    def set_awaited(self, axes: Iterable[str]) -> None:
        self._intake.awaited = frozenset(axes)
        self.counters.put("pmfid_axes_calibrating", len(self._intake.awaited))

    def seat(self, axis: str) -> Seat | None:
        """Return the seat of an axis by its name, or None."""
        return self._intake.seats.get(axis)

    def process(self, batch: Sequence[Delivery]) -> None:
        """Order deliveries, step their samples, and give out rows and notices."""
        begun = monotonic()
        self.changes += 1
        ordered = self._intake.take(batch)
        crash_point("engine.ordered")
        self._step(ordered)
        self._count(batch, begun)
        for delivery in batch:
            self.silence.note_delivery(delivery.source)
            if delivery.done is not None and self.keeper is not None:
                self.keeper.call_when_kept(delivery.done)
            elif delivery.done is not None:
                delivery.done()

    def _step(self, ordered: Ordered) -> None:
        found, followed = ordered.found, self.followed()
        for waiting in ordered.rounds:
            done = step(waiting, followed, self.silence.now)
            for name, number in done.counted.items():
                self.counters.add(name, number, group=waiting.group.kindred.config)
            found += [one for one in done.found if self._admit_event(one)]
            for rows in done.rows:
                for outlet in self.outlets:
                    outlet.rows(rows)
        crash_point("engine.stepped")
        found.sort(key=lambda one: (one.turn, one.sample))
        for one in found:
            self.notices.publish_event(one.seat, one.what)
        crash_point("engine.reported")

    def _admit_event(self, one: FoundEvent) -> bool:
        """Count an event, and return whether it becomes a notice. Repeated outliers are only counted."""
        event = str(one.what["event"])
        self.counters.add("pmfid_events_total", event=event, group=one.seat.group.kindred.config)
        return event != "outlier" or one.seat.may_tell(event)

    def _count(self, batch: Sequence[Delivery], begun: float) -> None:
        now = monotonic()
        self.counters.add("pmfid_deliveries_total", len(batch))
        self.counters.add("pmfid_engine_busy_seconds_total", now - begun)
        self.counters.put("pmfid_inbox_deliveries", len(self.inbox))
        ages = np.array([now - delivery.received for delivery in batch if delivery.received])
        self.counters.put("pmfid_latency_seconds", float(ages.max(initial=0.0)))
        for limit in TUNING.engine_slow:
            self.counters.add("pmfid_deliveries_slower_total", int(np.sum(ages > limit)), than=f"{limit:g}")

    def _obey(self) -> None:
        while self._asked:
            change, urgent = self._asked.popleft()
            change()
            self.changes += 1
            self.urgent |= urgent

    def _restart_numbers(self, axis: str) -> None:
        seat = self.seat(axis)
        if seat is None:
            return
        dropped, events = seat.restart_numbers()
        self.notices.publish_own(seat.name, {"event": "anew", "dropped": dropped})
        for event in events:
            self.notices.publish_event(seat, event_object(event, seat.group.kindred.names))

    def _acknowledge(self, number: int, note: str) -> None:
        alarm = self.notices.alarms.get(number)
        if alarm is None:
            self.tell({"event": "acknowledged", "alarm": None, "problem": f"no alarm has the number {number}"})
            return
        what = {key: alarm.what[key] for key in ("silent", "name") if "silent" in alarm.what}
        notice = {"event": "acknowledged", "alarm": number, "note": note, **what}
        self.notices.publish_own(alarm.axis, notice)

    def _refer(self, axis: str) -> None:
        seat = self.seat(axis)
        if seat is None:
            return
        group, index = seat.group, seat.index
        try:
            events = group.fleet.refer(index)
        except UsageError as error:
            self.notices.publish_own(seat.name, {"event": "reference", "problem": str(error)})
            return
        objects = [event_object(event, group.kindred.names) for event in events]
        normal = {name: value["value"] for name, value in objects[0]["parameters"].items()}
        seat.referred = tuple(normal.values())
        self.notices.publish_own(
            seat.name, {"event": "reference", "samples": int(group.numbers[index]), "nominal": normal}
        )
        for what in objects:
            self.notices.publish_event(seat, what)

    def speak(self) -> None:
        """Publish the notices of other threads."""
        while self._said:
            axis, what = self._said.popleft()
            self.notices.publish_own(axis, what)
