"""Calibrations by processes on all cores, so that the service itself stays responsive."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread

from pmfid.estimators.fleet import processors
from pmfid.service.tuning import TUNING
from pmfid.stream.groups import Prepared, prepare


def calibrate_all(paths: Sequence[Path], stopped: Event) -> Iterator[tuple[Path, Callable[[], Prepared]]]:
    """Yield each configuration when it is ready, with a function that returns it or raises its error.

    The processes begin in the order of `paths`. Each works alone, so that its end affects no other configuration. After
    `stopped` is set, `stop_workers` ends them.
    """
    count = min(processors(), len(paths))
    pools = SimpleQueue[ProcessPoolExecutor]()
    for _ in range(count):
        pools.put(_new_pool())
    threads = ThreadPoolExecutor(count, "calibration")
    try:
        futures = {threads.submit(_prepare_apart, path, pools, stopped): path for path in paths}
        for future in as_completed(futures):
            yield futures[future], future.result
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        while not pools.empty():
            pools.get().shutdown(wait=False, cancel_futures=True)


def _new_pool() -> ProcessPoolExecutor:
    """Return one process, which begins with its first task."""
    return ProcessPoolExecutor(1, get_context("spawn"), _begin)  # a fork of a process with threads may hang


def _prepare_apart(path: Path, pools: SimpleQueue[ProcessPoolExecutor], stopped: Event) -> Prepared:
    """Prepare a configuration in a process of `pools`. If someone kills the process, a new one tries once more."""
    pool = pools.get()
    try:
        for _ in range(2):
            try:
                return pool.submit(prepare, path).result()
            except BrokenProcessPool:
                pool = _new_pool()
                if stopped.is_set():
                    break
        raise OSError("the process of its calibration was killed twice; check the memory, and send SIGHUP")
    finally:
        pools.put(pool)


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
