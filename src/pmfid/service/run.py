"""The running service, with the signals and the systemd messages of its process."""

from __future__ import annotations

import gc
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from types import FrameType
from typing import TYPE_CHECKING, Any

from pmfid.config.axis import Axis
from pmfid.errors import PmfidError, UsageError
from pmfid.records.record import Record, read_record
from pmfid.service.arrangement import Configurations, arrange_groups, tell_configurations
from pmfid.service.context import Context
from pmfid.service.keeping import Checkpoints
from pmfid.service.plant import Plant
from pmfid.service.running import Running
from pmfid.service.sinks.plain import NoticeLog
from pmfid.service.sinks.queued import Queued
from pmfid.service.tuning import TUNING
from pmfid.service.web.board import Board
from pmfid.stream.checkpoint import Snapshot, read_snapshot
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared
from pmfid.stream.outcome import Counters, Notice, Outlet
from pmfid.stream.store import FILE, Vault
from pmfid.stream.tuning import TUNING as STREAM_TUNING

if TYPE_CHECKING:
    from pmfid.service.web.server import Page


_NOTHING = "no axis can be watched; correct the configurations that the log reports"


@contextmanager
def catch_signals(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Pass SIGINT, SIGTERM and SIGHUP to a handler inside the block. Some systems have no SIGHUP."""
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), handle) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def notify(state: str) -> None:
    """Send a state such as "READY=1", as sd_notify(3) does. Without a listener, nothing is sent."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.connect("\0" + address[1:] if address.startswith("@") else address)
        channel.send(state.encode())


@dataclass
class Service:
    """A service with its sources, engine and sinks.

    `load` reads the plant at the start and at SIGHUP. Notices are printed to `log`. With `until_end`, the service ends
    with its last source.

    The page starts first. Axes join the engine as they are calibrated, and a source that delivers a single axis waits
    for this axis. The axes of a checkpoint are restored together, and all sources wait for them.
    """

    load: Callable[[], Plant]
    log: NoticeLog
    until_end: bool = False
    counters: Counters = field(default_factory=Counters, init=False)

    def run(self) -> None:
        """Run until a signal, or until all sources end. Raises UsageError for a plant that cannot be served at all."""
        self._plant = plant = self.load()
        self._page: Page | None = None
        self._stopping = self._reload_due = False
        self._reloading: Thread | None = None
        self._prepare(plant)
        with catch_signals(self._handle_signal):
            try:
                self._start(plant)
                gc.set_threshold(TUNING.run_collected)
                notify("READY=1")
                self._watch()
            finally:
                notify("STOPPING=1")
                self._end()
        if (failed := self._unusable or self._failed) is not None:
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
        self._board = Board([], every=max(plant.service.every, 0.1))
        self._log = Queued(self.log, self.counters, lambda notice: None)
        self._log.start()
        self._outlets: list[Outlet] = [self._board, self._log]
        self._engine = StreamEngine(self.counters, self._outlets, self._board.list_followed)
        self._sinks: list[Queued] = []
        self._engine.silence.limit, self._engine.silence.sources = plant.service.silence, tuple(plant.sources)
        self._sources: list[Running] = []
        self._reported = time.monotonic()
        self._pace = Pace(plant.service.window, plant.service.every)
        self._configurations = Configurations(self._tell_now)
        self._axes: dict[str, Prepared] = {}
        self._keeper: Checkpoints | None = None
        self._unusable: BaseException | None = None
        self._problem: BaseException | None = None
        self._opened = False
        try:
            if not plant.sources:
                problem = "no source is configured, so no data will arrive: add [sources.NAME]"
                self._tell_now({"event": "source", "source": "", "problem": problem})
            if plant.state is not None:
                self._keep(Vault(plant.state), plant.service.checkpoint)
            self._configs = self._configurations.read(plant.axes)
            self._engine.set_awaited(name for name, path in plant.axes.items() if path in self._configs)
            self._saved: Snapshot | None = (
                None if self._keeper is None else self._keeper.vault.load(read_snapshot, self._tell_now)
            )
            if not self._configs:
                raise UsageError(_NOTHING)
        except BaseException:
            if self._keeper is not None:
                self._keeper.vault.close()
            self._log.close(TUNING.answer)
            raise
        restored = set[str]() if self._saved is None else set(self._saved.axes())
        self._needed = {path for name, path in plant.axes.items() if name in restored} & self._configs.keys()
        self._engine.waiting = bool(self._needed)
        if self._saved is not None:
            self._configurations.baselines = {group.digest: group.baseline for group in self._saved.groups}
            self._saved.restore(self._engine)
            for notice in self._saved.alarms:
                self._board.notice(notice)

    def _keep(self, vault: Vault, period: float) -> None:
        """Keep states and notices in the vault. Its states remain until those of the engine are complete."""
        self._keeper = Checkpoints(vault, period, self.counters, self._engine.tell)
        self._engine.keeper = self._keeper
        self._outlets.append(self._keeper)

    def _restore(self, keeper: Checkpoints) -> None:
        """Restore the axes of the checkpoint, all of which are calibrated."""
        keeper.begun = True
        saved, awaited = self._saved, len(self._engine.awaited)
        try:
            present = {prepared.digest: prepared for prepared in self._axes.values()}
            kept = [] if saved is None else [one for one in saved.groups if one.digest in present]
            groups = [one.restore_group(present[one.digest], self._pace) for one in kept]
        except ValueError as error:
            problem = f"the states in {FILE} cannot be used: {error}; the service starts without them"
            self._tell_now({"event": "checkpoint", "problem": problem})
            saved, groups = None, []
        fresh = self._arrange(groups)
        started = len(fresh) + awaited
        if saved is None:
            self._tell_now({"event": "checkpoint", "restored": 0, "fresh": started})
            return
        known = set(saved.axes())
        changed = [name for name in fresh if name in known]
        restored = {"event": "checkpoint", "restored": len(self._axes) - len(fresh), "fresh": started}
        more = {"changed": changed[: STREAM_TUNING.most_names]} if changed else {}
        self._tell_now({**restored, "made": saved.wall, **more})

    def _tell_now(self, what: dict[str, Any]) -> None:
        self._engine.notices.publish_own("", what)

    def _arrange(self, groups: list[Group]) -> list[str]:
        """Assign the axes to groups, including the given groups, and return the names of axes without a history."""
        made, fresh = arrange_groups(groups, self._axes, self._pace)
        self._engine.set_groups(made)
        seats = [seat for group in self._engine.groups for seat in group.seats]
        referred = {seat.name: seat.referred for seat in seats if seat.referred is not None}
        self._board.arrange([group.kindred for group in self._engine.groups], referred)
        return fresh

    def _start(self, plant: Plant) -> None:
        tell, find = self._engine.tell, self._find_axis
        context = Context(plant.service.name, plant.folder, self.counters, tell, find)
        self._sinks = [
            Queued(section.make(name, context), self.counters, tell, section.limits)
            for name, section in plant.sinks.items()
        ]
        self._engine.silence.sinks = self._sinks
        self._engine.unwritten = lambda: {sink.name: sink.unwritten() for sink in self._sinks}
        unwritten = {} if self._saved is None else self._saved.unwritten
        for queued in self._sinks:
            for notice in unwritten.get(queued.name, ()):
                queued.notice(notice)
        self._sources = [
            Running(section.make(name, context), self._engine.inbox, tell, getattr(section, "axis", None) or "")
            for name, section in plant.sources.items()
        ]
        self._engine.beat = time.monotonic()
        self._serve_page(plant)
        for queued in self._sinks:
            queued.start()
            self._outlets.append(queued)
        self._say_started(plant)
        self._configurations.tell = tell
        if not self._needed:
            self._admit(plant)
        self._thread = Thread(target=self._run_engine, name="engine", daemon=True)
        self._thread.start()
        self._reloading = Thread(target=self._calibrate, args=(plant,), name="calibration", daemon=True)
        self._reloading.start()

    def _calibrate(self, plant: Plant) -> None:
        """Calibrate the axes, which join the engine as they are ready."""
        names: dict[Path, list[str]] = {}
        for name, path in plant.axes.items():
            names.setdefault(path, []).append(name)
        try:
            for path, prepared in self._configurations.calibrate(dict(self._configs)):
                self._engine.ask(partial(self._join, plant, path, dict.fromkeys(names[path], prepared)))
            self._engine.ask(self._end_start)
        except BaseException as error:
            self._unusable = error

    def _join(self, plant: Plant, path: Path, axes: dict[str, Prepared | None]) -> None:
        """Take calibrated axes, or axes that cannot be used, in the engine's thread, between two ticks."""
        self._axes.update({name: prepared for name, prepared in axes.items() if prepared is not None})
        self._engine.set_awaited(self._engine.awaited - axes.keys())
        self._needed.discard(path)
        if not self._needed:
            self._admit(plant)

    def _admit(self, plant: Plant) -> None:
        """Let the calibrated axes join the engine, and start the sources that do not wait for others."""
        reported = {group.prepared.digest for group in self._engine.groups}
        if self._opened:
            self._arrange(self._engine.groups)
        elif self._keeper is not None:
            self._restore(self._keeper)
        else:
            self._arrange([])
        self._opened, self._engine.waiting = True, False
        tell_configurations(self._engine, reported)
        for running in self._sources:
            if running.axis not in self._engine.awaited:
                running.start()
        self._report_progress()

    def _report_progress(self) -> None:
        left, now = len(self._engine.awaited), time.monotonic()
        if left and self._axes and now - self._reported > TUNING.answer:
            self._reported = now
            self._tell_now({"event": "calibration", "watched": len(self._axes), "awaited": left})

    def _end_start(self) -> None:
        """End the start of the service, after the last calibration."""
        if not self._axes:
            self._unusable = UsageError(_NOTHING)
        gc.freeze()  # existing objects stay, so the collector need not examine them repeatedly

    def _find_axis(self, name: str) -> Axis | None:
        prepared, path = self._axes.get(name), self._plant.axes.get(name)
        if prepared is not None:
            return prepared.axis
        return None if path is None else self._configs.get(path)

    def _say_started(self, plant: Plant) -> None:
        """Report the start to all outlets. The log also gets the address of the page, and a terminal a new token."""
        state = None if plant.state is None else str(plant.state)
        serving = {"event": "serving", "name": plant.service.name, "axes": len(self._engine.awaited), "state": state}
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
        if not plant.page.enabled:
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
            plant.page,
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
        alive = time.monotonic()
        while not self._stopping and self._thread.is_alive():
            time.sleep(STREAM_TUNING.engine_idle)
            if self._reload_due:
                self._reload_due = False
                self._reload()
            if self._unusable or (all(one.ended for one in self._sources) and (self.until_end or self._failed)):
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
            rest = ", ".join(left[: STREAM_TUNING.most_names])
            reload["problem"] = (
                f"changes of {rest} are not applied, because only axes and fleets are read again; restart the "
                "service to apply them"
            )
        self._engine.tell(reload)

    # --- end ----------------------------------------------------------------------------------------------------------

    def _end(self) -> None:
        """End the sources first, then the engine after their last delivery, then the outlets."""
        self._configurations.stop()
        for running in self._sources:
            running.stop()
        for running in self._sources:
            running.join()
        self._engine.inbox.close()
        if hasattr(self, "_thread"):
            self._thread.join()
            self._tell_now({"event": "ended"})
        if self._keeper is not None:
            self._keeper.begun &= self._problem is None  # states of an engine that failed are no checkpoint
            self._keeper.offer(self._engine, last=True)
            self._engine.speak()
        if self._page is not None:
            self._page.stop()
        for sink in self._sinks:
            sink.close(TUNING.answer)
        self._log.close(TUNING.answer)
        if self._problem is not None:
            raise self._problem
