from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
) -> tuple[NDArray[np.float64], float]: ...
def products(signals: ArrayLike) -> NDArray[np.float64]: ...
def find_outliers(
    counts: NDArray[np.int64], times: ArrayLike, step: float, speed: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]: ...
def follow_states(
    phis: NDArray[np.float64],
    nows: NDArray[np.float64],
    changes: NDArray[np.float64],
    w: NDArray[np.float64],
    start: NDArray[np.float64],
) -> NDArray[np.float64]: ...

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
    numbers: tuple[NDArray[np.int64], NDArray[np.float64]]
    def step(self, u: float, counts: int) -> int: ...
    def rebase(self, counts: int) -> None: ...
    def before(self, samples: int) -> int: ...
    def pass_over(self, samples: int) -> None: ...

def follow_many(
    whole: NDArray[np.int64], real: NDArray[np.float64], u: NDArray[np.float64], counts: NDArray[np.int64]
) -> NDArray[np.int64]: ...
def bars(
    factor: NDArray[np.float64],
    variance: NDArray[np.float64],
    inflation: NDArray[np.float64],
    found: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]: ...
def put_rows(table: NDArray[Any], index: NDArray[np.int64], rows: NDArray[Any]) -> None: ...
def waiting_after(lost: bool, waiting: int, wait: int) -> int: ...

class Norms:
    def __init__(self, inverse: NDArray[np.float64], energy: NDArray[np.float64]) -> None: ...
    def deviations(self, score: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def expect(self, square: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def information(self, square: NDArray[np.float64]) -> NDArray[np.float64]: ...

def centred(
    score: NDArray[np.float64], cross: NDArray[np.float64], offset: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def weights(x: NDArray[np.float64], limit: NDArray[np.float64]) -> NDArray[np.float64]: ...

class Detection:
    rows: int
    def __init__(self, p: int, window: int) -> None: ...
    def run(
        self,
        state: NDArray[np.float64],
        x: NDArray[np.float64],
        w: NDArray[np.float64],
        tolerance: NDArray[np.float64],
    ) -> NDArray[np.float64]: ...

class Watcher:
    """`watched` is a `monitor.states.Watched`, and `disturbed` is a `monitor.states.Disturbed`."""

    def __init__(
        self,
        norms: Norms,
        seen: Norms,
        detection: Detection,
        work: tuple[float, NDArray[np.float64], NDArray[np.float64]],
        threshold: float,
        block_time: float,
        silent_blocks: int,
    ) -> None: ...
    def informed(self, watched: Any, block: NDArray[np.float64], lost: bool) -> tuple[NDArray[np.float64], float]: ...
    def whole(
        self, watched: Any, block: NDArray[np.float64], information: float, time: float
    ) -> tuple[bool, NDArray[np.float64]]: ...
    def counted(self, watched: Any, disturbed: Any, unit: NDArray[np.float64]) -> float: ...
    def crossed(self, watched: Any, information: float, status: int) -> bool: ...
    def looked(self, watched: Any, status: int) -> tuple[int, int]: ...
    def run(
        self,
        watched: Any,
        disturbed: Any,
        index: NDArray[np.int64],
        scored: tuple[NDArray[np.float64], NDArray[np.uint8]],
        status: NDArray[np.uint32],
        samples: NDArray[np.int64],
        filled: NDArray[np.int64],
        size: int,
        dt: float,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]: ...
