"""The running service, with the signals, the systemd messages and the pauses of its process."""

from __future__ import annotations

import gc
import os
import signal
import socket
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from threading import Event, Thread
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING, Any

from pmfid.config.axis import Axis
from pmfid.errors import PmfidError, UsageError
from pmfid.pipeline.monitored.stream import catch_signals
from pmfid.records.record import Record, read_record
from pmfid.service.arrangement import Configurations, arrange_groups, remember, tell_configurations
from pmfid.service.context import Context, Source, Tell
from pmfid.service.keeping import Checkpoints
from pmfid.service.plant import Plant, page_config
from pmfid.service.sinks.plain import NoticeLog
from pmfid.service.sinks.queued import Queued
from pmfid.service.tuning import TUNING
from pmfid.service.web.board import Board
from pmfid.stream.checkpoint import Snapshot, Vault, read_snapshot
from pmfid.stream.delivery import Delivery, Mark
from pmfid.stream.engine import Inbox, StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared
from pmfid.stream.outcome import Counters, Notice, Outlet

if TYPE_CHECKING:
    from pmfid.service.web.server import Page


@dataclass
class PauseWatch:
    """A reporter of pauses of the whole process, the only explanation for late estimates. Call `look` regularly."""

    tell: Callable[[dict[str, Any]], None]
    counters: Counters
    _looked: float = field(default_factory=monotonic, init=False)

    def look(self) -> None:
        now = monotonic()
        stood, self._looked = now - self._looked, now
        if stood > TUNING.process_stood:
            problem = (
                f"the service did not run for {stood:.0f} s: someone stopped the process, or the computer had "
                "no time for it"
            )
            self.tell({"event": "paused", "seconds": round(stood, 1), "problem": problem})
            self.counters.add("pmfid_paused_seconds_total", stood)


def notify(state: str) -> None:
    """Send a state such as "READY=1", as sd_notify(3) does. Without a listener, nothing is sent."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.connect("\0" + address[1:] if address.startswith("@") else address)
        channel.send(state.encode())


@dataclass
class Running:
    """A source in its thread.

    `failed` is the reported error that ended the source. `ended` is true if no further delivery will come.
    """

    source: Source
    inbox: Inbox
    tell: Tell
    marks: Mapping[str, Mark]
    failed: PmfidError | None = field(default=None, init=False)
    ended: bool = field(default=False, init=False)
    _mark: Mark | None = field(default=None, init=False)
    _broken: bool = field(default=False, init=False)
    _stopped: Event = field(default_factory=Event, init=False)

    def start(self) -> None:
        self._thread = Thread(target=self._run, name=f"source {self.source.name}", daemon=True)
        self._thread.start()

    def _take(self, delivery: Delivery) -> bool:
        if self._broken:
            self._broken = False
            self.tell({"event": "source", "source": self.source.name, "problem": ""})
        taken = self.inbox.put(delivery)
        if taken and delivery.mark is not None:
            self._mark = delivery.mark  # at a restart the marks of the engine are older
        return taken

    def _run(self) -> None:
        pause = TUNING.run_first_pause
        while not self._stopped.is_set():
            try:
                self.source.run(self._take, self._mark or self.marks.get(self.source.name))
                break
            except PmfidError as error:
                self.failed = error
                self.tell({"event": "source", "source": self.source.name, "problem": str(error), "ended": True})
                break
            except Exception as error:
                place = traceback.extract_tb(error.__traceback__)[-1]
                problem = (
                    f"{type(error).__name__}: {error} ({place.name}, line {place.lineno}); this part of the "
                    "service starts again"
                )
                self._broken = True
                self.tell({"event": "source", "source": self.source.name, "problem": problem})
                self._stopped.wait(pause)
                pause = min(2 * pause, TUNING.run_longest_pause)
        self.ended = True

    def stop(self) -> None:
        self._stopped.set()
        self.source.stop()

    def join(self) -> None:
        self._thread.join(TUNING.run_ending)


@dataclass
class Service:
    """A service with its sources, engine and sinks.

    `load` reads the plant at the start and at SIGHUP. Notices are printed to `log`. With `until_end`, the service ends
    with its last source. `record` is an already read record on which the only axis is watched.
    """

    load: Callable[[], Plant]
    log: NoticeLog
    until_end: bool = False
    record: Record | None = None
    counters: Counters = field(default_factory=Counters, init=False)

    def run(self) -> None:
        """Run until a signal, or until all sources end. Raises UsageError for a plant that cannot be served at all."""
        self._plant = plant = self.load()
        self._page: Page | None = None
        self._stopping = self._reload_due = False
        self._reloading: Thread | None = None
        self._prepare(plant)  # Opening may take minutes. A signal ends it immediately, because no thread runs yet.
        with catch_signals(self._handle_signal):
            try:
                self._start(plant)
                gc.freeze()  # existing objects stay, so the collector need not examine them repeatedly
                gc.set_threshold(TUNING.run_collected)
                notify("READY=1")
                self._watch()
            finally:
                notify("STOPPING=1")
                self._end()
        if (failed := self._failed) is not None:
            raise failed

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal. SIGINT and SIGTERM end the service, and SIGHUP reads PLANT.toml again."""
        self._stopping |= number in (signal.SIGINT, signal.SIGTERM)
        self._reload_due |= number not in (signal.SIGINT, signal.SIGTERM)

    @property
    def _failed(self) -> PmfidError | None:
        """Return the first error of the sources if all of them ended with an error, otherwise None."""
        errors = [one.failed for one in self._sources]
        return errors[0] if errors and all(errors) else None

    # --- start --------------------------------------------------------------------------------------------------------

    def _prepare(self, plant: Plant) -> None:
        """Do all steps that can fail before a thread runs."""
        self._board = Board([], self.counters, every=max(plant.service.every, 0.1))
        self._log = Queued(self.log, self.counters, lambda notice: None, rows_wanted=False)
        self._log.start()
        self._outlets: list[Outlet] = [self._board, self._log]
        self._engine = StreamEngine(self.counters, self._outlets, self._board.list_followed)
        self._sinks: list[Queued] = []
        self._engine.silence.limit, self._engine.silence.sources = plant.service.silence, tuple(plant.sources)
        self._unwritten: dict[str, list[Notice]] = {}
        self._sources: list[Running] = []
        self._pace = Pace(plant.service.window, plant.service.every)
        self._configurations = Configurations(self._tell_now, self.record)
        vault: Vault | None = None
        try:
            vault = self._check_plant(plant)
            self._axes: dict[str, Prepared] = self._configurations.load_all(plant.axes)
            if not self._axes:
                raise UsageError("no axis can be watched; correct the configurations that the log reports")
            self._restore(plant, vault)
        except BaseException:
            if vault is not None:
                vault.close()
            self._log.close(TUNING.run_ending)
            raise

    def _check_plant(self, plant: Plant) -> Vault | None:
        """Check the plant and report problems before the calibration of axes, which may take minutes."""
        page_config(plant)
        if not plant.sources:
            problem = "no source is configured, so no data will arrive: add [sources.NAME]"
            self._tell_now({"event": "source", "source": "", "problem": problem})
        return None if plant.state is None else Vault(plant.state)

    def _restore(self, plant: Plant, vault: Vault | None) -> None:
        if vault is None:
            self._arrange([])
            return
        found = vault.load(self._read, self._tell_now)
        engine = self._engine
        engine.keeper = Checkpoints(vault, plant.service.checkpoint, self.counters, engine.tell)
        if found is None:
            self._arrange([])
            self._tell_now({"event": "checkpoint", "restored": 0, "fresh": len(self._axes)})
            return
        saved, groups = found
        saved.restore(engine)
        self._unwritten = saved.unwritten
        for notice in engine.notices.replay_alarms(saved.alarms):
            self._board.notice(notice)
        fresh = self._arrange(groups)
        known = set(saved.axes())
        changed = [name for name in fresh if name in known]
        restored = {"event": "checkpoint", "restored": len(self._axes) - len(fresh), "fresh": len(fresh)}
        more = {"changed": changed[: TUNING.most_names]} if changed else {}
        self._tell_now({**restored, "made": saved.wall, **more})

    def _read(self, body: bytes) -> tuple[Snapshot, list[Group]]:
        """Return a checkpoint, and its groups with a configuration that still exists.

        Raises ValueError for an invalid checkpoint.
        """
        saved = read_snapshot(body)
        present = {prepared.digest: prepared for prepared in self._axes.values()}
        groups = [one.restore_group(present[one.digest], self._pace) for one in saved.groups if one.digest in present]
        return saved, groups

    def _tell_now(self, what: dict[str, Any]) -> None:
        self._engine.notices.publish_own("", what)

    def _arrange(self, groups: list[Group]) -> list[str]:
        """Assign the axes to groups, including the given groups, and return the names of axes without a history."""
        made, fresh = arrange_groups(groups, self._axes, self._pace)
        self._engine.set_groups(made)
        remember(self._engine)
        seats = [seat for group in self._engine.groups for seat in group.seats]
        referred = {seat.name: seat.referred for seat in seats if seat.referred is not None}
        self._board.arrange([group.kindred for group in self._engine.groups], referred)
        return fresh

    def _start(self, plant: Plant) -> None:
        tell, find = self._engine.tell, self._find_axis
        context = Context(plant.service.name, plant.folder, plant.state, self.counters, tell, find)
        self._sinks = [section.outlet(name, context) for name, section in plant.sinks.items()]
        self._engine.silence.sinks = self._sinks
        self._engine.unwritten = lambda: {sink.name: sink.unwritten() for sink in self._sinks}
        for queued in self._sinks:
            for notice in self._unwritten.get(queued.name, ()):
                queued.notice(notice)
        sources = [section.make(name, context) for name, section in plant.sources.items()]
        self._serve_page(plant)
        for queued in self._sinks:
            queued.start()
            self._outlets.append(queued)
        self._say_started(plant)
        tell_configurations(self._engine)
        self._thread = Thread(target=self._run_engine, name="engine", daemon=True)
        self._problem: BaseException | None = None
        self._thread.start()
        self._sources = [
            Running(source, self._engine.inbox, self._engine.tell, self._engine.marks) for source in sources
        ]
        for running in self._sources:
            running.start()

    def _find_axis(self, name: str) -> Axis | None:
        prepared = self._axes.get(name)
        return None if prepared is None else prepared.axis

    def _say_started(self, plant: Plant) -> None:
        """Report the start to all outlets. The log also gets the address of the page, and a terminal a new token."""
        state = None if plant.state is None else str(plant.state)
        serving = {"event": "serving", "name": plant.service.name, "axes": len(self._axes), "state": state}
        self._outlets.remove(self._log)
        number = self._engine.notices.publish_own("", serving).number
        self._outlets.append(self._log)
        self._log.notice(Notice("", number, time.time(), {**serving, **self._page_address(plant)}))

    def _page_address(self, plant: Plant) -> dict[str, Any]:
        page = self._page
        if page is None:
            return {}
        if page.made_token is None or self.log.stream.isatty():
            return {"page": page.start_url, "notes": list(page.notes)}
        from pmfid.service.web.security import keep_token

        return {"page": page.url, "notes": [*page.notes, keep_token(page.made_token, plant.state)]}

    def _serve_page(self, plant: Plant) -> None:
        config = page_config(plant)
        if not config.enabled:
            return
        try:
            from pmfid.service.metrics import exposition
            from pmfid.service.web.server import serve
        except ImportError:
            raise UsageError(
                "the page needs an optional package: pip install 'pmfid[serve]'; to run without the page, use "
                "--no-page, or [page] enabled = false"
            ) from None

        self._page = serve(
            config,
            plant.service.name,
            self._board,
            self.counters,
            self._engine,
            folder=plant.folder,
            reference=self._reference,
            metrics=partial(exposition, self.counters),
            alive=self._alive,
        )

    def _alive(self) -> bool:
        return time.monotonic() - self._engine.beat < TUNING.run_stuck

    def _reference(self, axis: str) -> Record | None:
        """Return the record of normal work of an axis."""
        prepared = self._axes.get(axis)
        if prepared is None or prepared.axis.monitor.reference is None:
            return None
        return read_record(prepared.path.parent / prepared.axis.monitor.reference, prepared.axis)

    # --- while it runs ------------------------------------------------------------------------------------------------

    def _run_engine(self) -> None:
        try:
            self._engine.run()
        except BaseException as error:
            self._problem = error
            self._engine.inbox.close()

    def _watch(self) -> None:
        alive, standing = time.monotonic(), PauseWatch(self._engine.tell, self.counters)
        while not self._stopping and self._thread.is_alive():
            time.sleep(TUNING.run_look)
            standing.look()
            if self._reload_due:
                self._reload_due = False
                self._reload()
            if all(one.ended for one in self._sources) and (self.until_end or self._failed):
                return
            if time.monotonic() - alive > 1 and self._alive():
                alive = time.monotonic()
                notify("WATCHDOG=1")

    def _reload(self) -> None:
        """Read the plant again in a thread, so that new calibrations do not delay other axes."""
        if self._reloading is not None and self._reloading.is_alive():
            self._engine.tell(
                {
                    "event": "reload",
                    "problem": "the previous request to read the configuration is still in progress; try again later",
                }
            )
            return
        self._reloading = Thread(target=self._read_again, name="reload", daemon=True)
        self._reloading.start()

    def _read_again(self) -> None:
        try:
            plant = self.load()
            self._configurations.tell = self._engine.tell
            axes = self._configurations.load_all(plant.axes)
        except (PmfidError, OSError) as error:
            self._engine.tell(
                {"event": "reload", "problem": f"{error}; the service continues with its previous configuration"}
            )
            return
        self._engine.ask(lambda: self._adopt(plant, axes))

    def _adopt(self, plant: Plant, axes: dict[str, Prepared]) -> None:
        """Adopt a new plant, in the engine's thread, between two ticks."""
        before, self._axes = self._axes, axes
        fresh = self._arrange(self._engine.groups)
        tell_configurations(self._engine)
        gone = sum(name not in axes for name in before)
        changed = sum(name in before for name in fresh)
        reload = {"event": "reload", "added": len(fresh) - changed, "changed": changed, "removed": gone}
        if left := plant.unlike(self._plant):
            rest = ", ".join(left[: TUNING.most_names])
            reload["problem"] = (
                f"changes of {rest} are not applied, because only axes and fleets are read again; restart the "
                "service to apply them"
            )
        self._engine.tell(reload)

    # --- end ----------------------------------------------------------------------------------------------------------

    def _end(self) -> None:
        """End the sources first, then the engine after their last delivery, then the outlets."""
        for running in self._sources:
            running.stop()
        for running in self._sources:
            running.join()
        self._engine.inbox.close()
        if hasattr(self, "_thread"):
            self._thread.join()
            self._tell_now({"event": "ended"})
        else:
            self._engine.keeper.offer(self._engine, last=True)
        if self._page is not None:
            self._page.stop()
        for sink in self._sinks:
            sink.close(TUNING.run_ending)
        self._log.close(TUNING.run_ending)
        if getattr(self, "_problem", None) is not None:
            raise self._problem  # type: ignore[misc]
