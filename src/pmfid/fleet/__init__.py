"""Histories of many axes, with estimates for each axis and period, changed axes, and axes that differ from similar
ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.lazy_imports import make_getattr, read_names

if TYPE_CHECKING:
    from pmfid.fleet.evaluate import Work as Work
    from pmfid.fleet.history import History as History
    from pmfid.fleet.history import estimate as estimate
    from pmfid.fleet.source import SourceColumns as SourceColumns

_PUBLIC = read_names(__file__)
__all__ = sorted(_PUBLIC)
if not TYPE_CHECKING:  # a type checker would accept every misspelt name
    __getattr__ = make_getattr(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return list(__all__)
