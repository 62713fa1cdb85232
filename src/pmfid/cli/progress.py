"""How far a long run is: a bar on a terminal, and where standard error goes elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import click

#: Called with the part of the work that is done, 0 to 1.
Done = Callable[[float], None]

#: Time before the first line and between two lines [s].
EVERY = 10.0
#: Part of the work between two lines.
STEP = 0.05


@dataclass
class Lines:
    """Tells the part that is done, at most one line in EVERY seconds and in STEP of the work; a short run has none."""

    what: str
    write: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic
    _start: float = field(init=False)
    _last: float = field(init=False)
    _told: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self._start = self._last = self.clock()

    def __call__(self, done: float) -> None:
        now = self.clock()
        if now - self._last >= EVERY and done - self._told >= STEP:
            self.write(f"pmfid: {self.what}: {done:.0%} after {now - self._start:.0f} s")
            self._last, self._told = now, done


@contextmanager
def progress(what: str, quiet: bool = False) -> Iterator[Done | None]:
    """What to call with the part that is done; None where nothing is to be told."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(what, total=1.0)
            yield lambda done: bar.update(task, completed=done)
    else:
        yield Lines(what, _tell)


def _tell(line: str) -> None:
    click.echo(line, err=True)
    sys.stderr.flush()
