"""The page in a thread of its own: `serve` starts it, `Page.stop` ends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from pmfid.service.board import Board
from pmfid.service.counters import Counters
from pmfid.service.web.config import PageConfig
from pmfid.session.records import Record

__all__ = ["Acts", "Page", "serve"]


class Acts(Protocol):
    """What the page may ask of the engine; each is False where the engine has no room for more at the moment. What
    became of it comes back as a `Notice`."""

    def acknowledge(self, number: int, note: str) -> bool:
        """The alarm that was told as the notice of this number is known to people."""
        ...

    def refer(self, axis: str) -> bool:
        """What the axis is now is normal: deviations count from there."""
        ...


@dataclass
class Page:
    """A page that is being served. url: for the start line, with the token where it was made by this start; notes:
    what to know about it, sentences."""

    url: str
    notes: tuple[str, ...] = ()

    def stop(self) -> None:
        """Ends streams and thread; returns within two seconds. May be called twice."""


def serve(
    config: PageConfig,
    name: str,
    board: Board,
    counters: Counters,
    acts: Acts,
    *,
    folder: Path,
    reference: Callable[[str], Record | None] = lambda axis: None,
    metrics: Callable[[], str] | None = None,
) -> Page:
    """Starts to serve the page. name: of the service; folder: that of PLANT.toml; reference: record of normal work of
    an axis, by its name, read when someone asks (it may raise UsageError); metrics: text for Prometheus. Raises
    UsageError where the address cannot be had, a token is missing, or the extra is not installed."""
    raise NotImplementedError
