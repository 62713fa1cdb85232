"""The kinds of sources and sinks by their names in PLANT.toml; each is imported when a plant uses it.

The class of a section is light to import; what `make` needs beyond it is imported there, and where that is an extra
which is missing, `make` raises UsageError with the command that installs it.
"""

from __future__ import annotations

from collections.abc import Callable

from pmfid.service.context import Context
from pmfid.service.sinks import Sink
from pmfid.service.sources import Source
from pmfid.session.toml_file import FileSection

__all__ = ["SINKS", "SOURCES", "SinkSection", "SourceSection"]


class SourceSection(FileSection):
    """[sources.NAME]: `kind` and what that kind needs."""

    def make(self, name: str, context: Context) -> Source:
        """The source, not yet running. Raises UsageError for what the file alone does not show."""
        raise NotImplementedError


class SinkSection(FileSection):
    """[sinks.NAME]: `kind` and what that kind needs."""

    def make(self, name: str, context: Context) -> Sink:
        """The sink, not yet open. Raises UsageError for what the file alone does not show."""
        raise NotImplementedError


def _file() -> type[SourceSection]:
    from pmfid.service.sources.file import FileSource

    return FileSource


def _stdin() -> type[SourceSection]:
    from pmfid.service.sources.file import StdinSource

    return StdinSource


SOURCES: dict[str, Callable[[], type[SourceSection]]] = {"file": _file, "stdin": _stdin}
SINKS: dict[str, Callable[[], type[SinkSection]]] = {}
