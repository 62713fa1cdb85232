"""Sources in threads of their own."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field
from threading import Event, Thread

from pmfid.errors import PmfidError
from pmfid.service.broker import pauses
from pmfid.service.context import Source, Tell
from pmfid.service.tuning import TUNING
from pmfid.stream.delivery import Delivery
from pmfid.stream.engine import Inbox


@dataclass
class Running:
    """A source in its thread. `axis` is the only axis that the source delivers, or "" for a source of many axes.

    `failed` is the reported error that ended the source. `ended` is true if no further delivery will come.
    """

    source: Source
    inbox: Inbox
    tell: Tell
    axis: str = ""
    failed: PmfidError | None = field(default=None, init=False)
    ended: bool = field(default=False, init=False)
    _broken: bool = field(default=False, init=False)
    _stopped: Event = field(default_factory=Event, init=False)
    _thread: Thread | None = field(default=None, init=False)

    def start(self) -> None:
        """Start the source, once."""
        if self._thread is None:
            self._thread = Thread(target=self._run, name=f"source {self.source.name}", daemon=True)
            self._thread.start()

    def _take(self, delivery: Delivery) -> bool:
        if self._broken:
            self._broken = False
            self.tell({"event": "source", "source": self.source.name, "problem": ""})
        return self.inbox.put(delivery)

    def _run(self) -> None:
        waiting = pauses()
        while not self._stopped.is_set():
            try:
                self.source.run(self._take)
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
                self._stopped.wait(next(waiting))
        self.ended = True

    def stop(self) -> None:
        self._stopped.set()
        self.source.stop()

    def join(self) -> None:
        if self._thread is not None:
            self._thread.join(TUNING.answer)
