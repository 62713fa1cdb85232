"""The engine of one machine: threads, for polars and the kernel let each other go on."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Condition
from typing import ClassVar, Protocol, TypeVar

from pmfid.errors import whole_number

A = TypeVar("A")
B = TypeVar("B")


class Engine(Protocol):
    """Where the work of a history is done."""

    name: ClassVar[str]

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """work of each item, in the order of the items."""
        ...


@dataclass(frozen=True)
class Local:
    """workers: threads; None: as many as there are processors. How many have a shard in memory is up to `RowBudget`."""

    name: ClassVar[str] = "local"
    workers: int | None = None

    def __post_init__(self) -> None:
        if self.workers is not None:
            whole_number("workers", self.workers, 1, "it is the number of threads; None: as many as processors")

    def map(self, work: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """No more is under way than there are workers, and one result that waits for each."""
        many = self.workers or _processors()
        with ThreadPoolExecutor(many) as pool:
            waiting: deque[Future[B]] = deque()
            try:
                for item in items:
                    waiting.append(pool.submit(work, item))
                    if len(waiting) > 2 * many:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()


class RowBudget:
    """Rows that threads may have in memory together, so that memory knows no number of processors."""

    def __init__(self, rows: int) -> None:
        self._rows, self._used = rows, 0
        self._freed = Condition()

    @contextmanager
    def reserve(self, rows: int) -> Iterator[None]:
        """Waits until this number of rows fits into the budget; a larger request waits for the whole budget."""
        own = min(rows, self._rows)
        with self._freed:
            self._freed.wait_for(lambda: self._used + own <= self._rows)
            self._used += own
        try:
            yield
        finally:
            with self._freed:
                self._used -= own
                self._freed.notify_all()


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
