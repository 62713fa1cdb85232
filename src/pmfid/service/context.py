"""What a source or a sink may use of the service that starts it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmfid.service.counters import Counters
from pmfid.session.config import Axis

__all__ = ["Context"]


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
