"""The part of the service that a source may use, and the base of all sections of sources in PLANT.toml."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pmfid.config.axis import Axis
from pmfid.config.toml_file import FileSection
from pmfid.service.sources import Source
from pmfid.stream.commands import Counters

__all__ = ["Axes", "Context", "SourceSection"]


class Axes(Protocol):
    """Names of axes -> what their AXIS.toml says, as it is when it is looked at; a dictionary is one, too."""

    def get(self, name: str, /) -> Axis | None: ...


@dataclass(frozen=True)
class Context:
    """name: of the service; folder: of PLANT.toml, to which names of files are relative; state: folder of the
    checkpoints, None without checkpoints; counters: of the service; tell: makes a notice of the service of an object
    with "event", as `Notice.what`, from any thread; axis: AXIS.toml of an axis by its name, None if there is no such
    axis.
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
