"""Calibrations by processes on all cores, so that the service itself stays responsive."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread

from pmfid.estimators.runner import processors
from pmfid.service.tuning import TUNING
from pmfid.stream.groups import Prepared, prepare


def calibrate_all(paths: Sequence[Path]) -> Iterator[tuple[Path, Callable[[], Prepared]]]:
    """Yield each configuration when it is ready, with a function that returns it or raises its error.

    The processes begin in the order of `paths`. `stop_workers` ends them.
    """
    context = get_context("spawn")  # a fork of a process with threads may hang
    pool = ProcessPoolExecutor(min(processors(), len(paths)), context, _begin)
    try:
        futures = {pool.submit(prepare, path): path for path in paths}
        for future in as_completed(futures):
            yield futures[future], partial(_take, future)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def stop_workers() -> None:
    """End all processes. Any thread may call this function."""
    for process in active_children():
        process.terminate()


def _begin() -> None:
    """Prepare a process. The process ends with the service, even if the service is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the service, which ends this process
    with suppress(AttributeError, OSError):
        os.nice(TUNING.workers_nice)
    Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    service = parent_process()
    assert service is not None
    service.join()
    os._exit(1)


def _take(future: Future[Prepared]) -> Prepared:
    try:
        return future.result()
    except BrokenProcessPool:
        raise OSError("the process of its calibration was killed; check the memory, and send SIGHUP") from None
