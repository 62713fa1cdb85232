"""Origins of data: one file for each kind of source."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from pmfid.stream.delivery import Delivery, Mark

__all__ = ["CHUNK", "Source", "Take"]

#: Bytes that are read at once.
CHUNK = 65_536

#: Hands a delivery to the engine and waits while the inbox is full; False once the service ends: then the source
#: returns, and what was not taken counts as not received.
Take = Callable[[Delivery], bool]


class Source(Protocol):
    """Runs in a thread of its own.

    name: in PLANT.toml. `run` hands over what comes until the source ends, `stop` is called or `take` says False; it
    connects again by itself after errors, with growing pauses, and tells them through `tell` (an object with "event":
    "source", "source": name, "problem": ...). mark: of the last checkpoint, None at the first start; what was handed
    over since is asked for again where that is possible. `stop` may be called from any thread, at any time, twice.
    """

    name: str

    def run(self, take: Take, mark: Mark | None) -> None: ...

    def stop(self) -> None: ...
