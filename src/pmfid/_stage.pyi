from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Counts = NDArray[np.int64]
Floats = NDArray[np.float64]

EDGE: float

SAMPLES: int
LOST: int
KNOWN: int
CHANGED: int
FRESH: int
KEPT: int
USUAL: int
SAME: int
ALONE: int
POWER: int

def first_order(
    signal: ArrayLike, a: float, b0: float, b1: float = 0.0, memory: float = 0.0
) -> tuple[Floats, float]: ...
def products(signals: ArrayLike) -> Floats: ...
def find_outliers(
    counts: Counts, times: ArrayLike, step: float, speed: float = 0.0
) -> tuple[Counts, NDArray[np.bool_], Counts]: ...
def follow_states(phis: Floats, nows: Floats, changes: Floats, w: Floats, start: Floats) -> Floats: ...

class Inputs:
    counts: int
    zero: int
    samples: int
    lost: bool
    input: float
    usual: float
    fresh: int
    known: bool
    same: float
    alone: float
    power: float
    numbers: tuple[Counts, Floats]
    def step(self, u: float, counts: int) -> int: ...
    def rebase(self, counts: int) -> None: ...
    def before(self, samples: int) -> int: ...
    def pass_over(self, samples: int) -> None: ...

def follow_many(whole: Counts, real: Floats, u: Floats, counts: Counts) -> Counts: ...
def bars(factor: Floats, variance: Floats, inflation: Floats, found: Floats | None = None) -> Floats: ...
def put_rows(table: NDArray[Any], index: Counts, rows: NDArray[Any]) -> None: ...
def waiting_after(lost: bool, waiting: int, wait: int) -> int: ...

class Norms:
    def __init__(self, inverse: Floats, energy: Floats) -> None: ...
    def deviations(self, score: Floats, sigma: Floats) -> Floats: ...
    def expect(self, square: Floats) -> Floats: ...
    def information(self, square: Floats) -> Floats: ...

def centred(score: Floats, cross: Floats, offset: Floats) -> Floats: ...
def weights(x: Floats, limit: Floats) -> Floats: ...

class Detection:
    rows: int
    def __init__(self, p: int, window: int) -> None: ...
    def run(self, state: Floats, x: Floats, w: Floats, tolerance: Floats) -> Floats: ...

class Watcher:
    """`watched` is a `monitor.states.Watched`, and `disturbed` is a `monitor.states.Disturbed`."""

    def __init__(
        self,
        norms: Norms,
        seen: Norms,
        detection: Detection,
        work: tuple[float, Floats, Floats],
        threshold: float,
        block_time: float,
        silent_blocks: int,
    ) -> None: ...
    def informed(self, watched: Any, block: Floats, lost: bool) -> tuple[Floats, float]: ...
    def whole(self, watched: Any, block: Floats, information: float, time: float) -> tuple[bool, Floats]: ...
    def counted(self, watched: Any, disturbed: Any, unit: Floats) -> float: ...
    def crossed(self, watched: Any, information: float, status: int) -> bool: ...
    def looked(self, watched: Any, status: int) -> tuple[int, int]: ...
    def run(
        self,
        watched: Any,
        disturbed: Any,
        index: Counts,
        scored: tuple[Floats, NDArray[np.uint8]],
        status: NDArray[np.uint32],
        samples: Counts,
        filled: Counts,
        size: int,
        dt: float,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]: ...
