"""Sources and their threads: their start, their restart after an unexpected error, their end."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import Any

from pmfid.errors import PmfidError
from pmfid.service.sources import Source
from pmfid.stream.delivery import Delivery, Mark
from pmfid.stream.inbox import Inbox

__all__ = ["Running", "Sources"]

#: Pauses after an unexpected error [s]: the first, and the longest.
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 60.0

Tell = Callable[[dict[str, Any]], None]


@dataclass
class Running:
    """A source in its thread. failed: the reported error that ended it; ended: no further delivery will come."""

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
        """Starts the thread."""
        self._thread = Thread(target=self._run, name=f"source {self.source.name}", daemon=True)
        self._thread.start()

    def _take(self, delivery: Delivery) -> bool:
        if self._broken:
            self._broken = False
            self.tell({"event": "source", "source": self.source.name, "problem": ""})
        taken = self.inbox.put(delivery)
        if taken and delivery.mark is not None:
            self._mark = delivery.mark  # start of a restart: the marks of the engine are older
        return taken

    def _run(self) -> None:
        pause = FIRST_PAUSE
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
                problem = f"{type(error).__name__}: {error} ({place.name}, line {place.lineno}); it begins again"
                self._broken = True
                self.tell({"event": "source", "source": self.source.name, "problem": problem})
                self._stopped.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
        self.ended = True

    def stop(self) -> None:
        """Asks the source to end."""
        self._stopped.set()
        self.source.stop()

    def join(self, timeout: float) -> None:
        """Waits for its end, at most `timeout` [s]."""
        self._thread.join(timeout)


@dataclass
class Sources:
    """All sources that run, by name."""

    inbox: Inbox
    tell: Tell
    marks: Mapping[str, Mark]
    running: dict[str, Running] = field(default_factory=dict, init=False)

    def start(self, source: Source) -> None:
        """Starts a source."""
        self.running[source.name] = Running(source, self.inbox, self.tell, self.marks)
        self.running[source.name].start()

    @property
    def ended(self) -> bool:
        """Whether none of them will hand over anything more."""
        return all(one.ended for one in self.running.values())

    @property
    def failed(self) -> PmfidError | None:
        """The first error, where every one of them ended with one."""
        errors = [one.failed for one in self.running.values()]
        return errors[0] if errors and all(errors) else None

    def stop(self, within: float) -> None:
        """Ends all of them."""
        for one in self.running.values():
            one.stop()
        for one in self.running.values():
            one.join(within)
