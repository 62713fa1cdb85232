"""What a source may use of the service that starts it, and what all their sections in PLANT.toml have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pmfid.service.sources import Source
from pmfid.session.config import Axis
from pmfid.session.toml_file import FileSection
from pmfid.stream.counters import Counters

__all__ = ["Axes", "Context", "SourceSection"]


class Axes(Protocol):
    """Names of axes -> what their AXIS.toml says, as it is when it is looked at; a dictionary is one, too."""

    def get(self, name: str, /) -> Axis | None: ...


@dataclass(frozen=True)
class Context:
    """name: of the service; folder: that of PLANT.toml, from which names of files count; state: where the service
    keeps what must survive, None where it keeps nothing; counters: those of the service; tell: an object with "event",
    as `Notice.what`, which becomes a notice of the service, from any thread; axis: AXIS.toml of an axis by the name of
    the axis, None where there is no such axis.
    """

    name: str
    folder: Path
    state: Path | None
    counters: Counters
    tell: Callable[[dict[str, Any]], None]
    axis: Callable[[str], Axis | None]

    @property
    def axes(self) -> Axes:
        """The same as a mapping."""
        return _Looked(self.axis)


@dataclass(frozen=True)
class _Looked:
    """`Axes` by a function."""

    of: Callable[[str], Axis | None]

    def get(self, name: str, /) -> Axis | None:
        """Of an axis, or None."""
        return self.of(name)


class SourceSection(FileSection):
    """[sources.NAME]: `kind` and what that kind needs."""

    def make(self, name: str, context: Context) -> Source:
        """The source, not yet running. Raises UsageError for what the file alone does not show."""
        raise NotImplementedError
