"""Outcomes of the engine: rows of estimates of many axes, and notices of single events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

__all__ = ["EstimateRows", "Kindred", "Notice", "Outlet"]


@dataclass(frozen=True)
class Kindred:
    """Axes of the same configuration, which are stepped together.

    config: name of their AXIS.toml; names, units: of the q parameters in rows; dt: sample period [s]; nominal:
    (q,) normal values; axes: their names in PLANT.toml, by their number within the group; input_unit: of u;
    resolution: of one count [position_unit].
    """

    config: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    dt: float
    nominal: Floats
    axes: tuple[str, ...]
    input_unit: str = ""
    resolution: float = 1.0
    position_unit: str = "counts"


@dataclass(frozen=True)
class EstimateRows:
    """Estimates of axes of one group, m rows in the order of time for each axis.

    axis: (m,) number within the group; number: (m,) samples of that axis so far, this one included; time: (m,) [s] by
    the axis's clock; u: (m,); counts: (m,); theta, std: (m, q), std infinite while nothing is known; innovation: (m,);
    status: (m,) bits of `Status`; state: (m,) number of the state in `monitor.events.STATES`; received:
    `time.monotonic()` of the delivery that brought the latest of these samples.
    """

    group: Kindred
    axis: NDArray[np.int64]
    number: NDArray[np.int64]
    time: Floats
    u: Floats
    counts: NDArray[np.int64]
    theta: Floats
    std: Floats
    innovation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]
    received: float = 0.0


@dataclass(frozen=True)
class Notice:
    """An event of one axis, or of the service if axis is "".

    number: its own, in JSON a number like any other; later notices of an axis have higher numbers. A notice on data
    that come again after a restart has its former number, which identifies a repeated notice;
    wall: seconds since 1970 at the event; what: the object that `pmfid monitor --json` prints for an event
    ("event": alarm, state, settled, outlier, gap, clock, ...), or one of the service's own of the same form (late,
    duplicate, unusable, dropped, checkpoint, acknowledged, reference, source, sink).
    """

    axis: str
    number: int
    wall: float
    what: dict[str, Any]


class Outlet(Protocol):
    """A receiver of outcomes. The engine's thread calls it: neither method may wait for anything."""

    def rows(self, rows: EstimateRows) -> None: ...

    def notice(self, notice: Notice) -> None: ...
