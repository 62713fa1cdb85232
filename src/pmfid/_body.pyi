from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Length of a step, from its bounds, the slope and the curvature of the prior, and a chance.
Draw = Callable[[float, float, float, float, float], float]
BASE: int
LOOP: int
ELASTIC_BASE: int
KINDS: dict[str, int]

def run(
    forces: list[tuple[int, int, bool, Floats, float, float, bool]],
    step: Floats,
    u: Floats,
    row: NDArray[np.int32],
    columns: Floats,
    theta: Floats,
    parts: int,
    lift: Floats | None,
    tick: float = 0.0,
    on: Floats | None = None,
    elastic: bool = False,
    load: bool = False,
    count: float = 0.0,
) -> tuple[Floats, Floats, Floats, int]: ...
def drive_load(x: Floats, step: float, parts: int, loads: Floats) -> Floats: ...
def whiten(
    X: Floats, step: Floats, variance: Floats, rate: float, force: tuple[float, float], position: tuple[float, float]
) -> float: ...
def walk(
    e: Floats, bound: Floats, along: Floats, pull: Floats, bends: Floats, chances: list[float], far: float, draw: Draw
) -> Floats: ...
