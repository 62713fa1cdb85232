"""The kinds of sources and sinks by their names in PLANT.toml; each is imported when a plant uses it.

The class of a section is light to import; what `make` needs beyond it is imported there, and where that is an extra
which is missing, `make` raises UsageError with the command that installs it.
"""

from __future__ import annotations

from collections.abc import Callable

from pmfid.service.context import SourceSection
from pmfid.service.sinks.section import SinkSection

__all__ = ["SINKS", "SOURCES"]


def _file() -> type[SourceSection]:
    from pmfid.service.sources.file import FileSource

    return FileSource


def _stdin() -> type[SourceSection]:
    from pmfid.service.sources.file import StdinSource

    return StdinSource


SOURCES: dict[str, Callable[[], type[SourceSection]]] = {"file": _file, "stdin": _stdin}
SINKS: dict[str, Callable[[], type[SinkSection]]] = {}
