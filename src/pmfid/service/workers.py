"""Calibrations by processes on all cores, so that the service itself stays responsive."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from pmfid.errors import PmfidError
from pmfid.estimators.runner import processors
from pmfid.service.tuning import TUNING
from pmfid.stream.groups import Prepared, prepare

#: A calibrated configuration, or the error of its calibration.
Outcome = Prepared | PmfidError | OSError


class Workers:
    """Processes that calibrate configurations in the order of `paths`."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self._waiting = list(paths)[::-1]
        self._context = get_context("spawn")  # a fork of a process with threads may hang
        self._busy: dict[Connection, Path] = {}
        self._processes = list[BaseProcess]()
        self._stopped = False

    def run(self) -> Iterator[tuple[Path, Callable[[], Prepared]]]:
        """Yield each configuration when it is ready, with a function that returns it or raises its error."""
        try:
            for _ in range(min(processors(), len(self._waiting))):
                self._give_next(self._start())
            while self._busy:
                ready = wait(list(self._busy))
                for channel in [one for one in self._busy if one in ready]:
                    path, outcome = self._busy.pop(channel), self._receive(channel)
                    if self._stopped:
                        return
                    yield path, partial(_unpack, outcome)
        finally:
            self.stop()

    def stop(self) -> None:
        """End all processes. Any thread may call this function."""
        self._stopped = True
        for process in self._processes:
            process.terminate()

    def _start(self) -> Connection:
        channel, far_end = self._context.Pipe()
        process = self._context.Process(target=calibrate_in_turn, args=(far_end,), daemon=True)
        process.start()
        self._processes.append(process)
        far_end.close()
        return channel

    def _give_next(self, channel: Connection) -> None:
        if self._waiting:
            self._busy[channel] = self._waiting.pop()
            with suppress(OSError):  # `run` notices the end of a process
                channel.send(self._busy[channel])

    def _receive(self, channel: Connection) -> Outcome:
        try:
            outcome: Outcome = channel.recv()
        except (EOFError, OSError):
            outcome = OSError("the process of its calibration was killed; check the memory, and send SIGHUP")
            channel = self._start() if self._waiting and not self._stopped else channel
        self._give_next(channel)
        return outcome


def calibrate_in_turn(channel: Connection) -> None:
    """Calibrate the configurations whose paths arrive, until the service closes the channel or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the service, which ends this process
    with suppress(AttributeError, OSError):
        os.nice(TUNING.workers_nice)
    with suppress(EOFError, OSError):
        while True:
            channel.send(_calibrate(channel.recv()))


def _calibrate(path: Path) -> Outcome:
    try:
        return prepare(path)
    except (PmfidError, OSError) as error:
        return error


def _unpack(outcome: Outcome) -> Prepared:
    if isinstance(outcome, Prepared):
        return outcome
    raise outcome
