import numpy as np
from numpy.typing import ArrayLike, NDArray

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

class Inputs:
    counts: int
    zero: int
    change: int
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
    def run(self, u: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.int64]: ...
    def rebase(self, counts: int) -> None: ...
    def before(self, samples: int) -> int: ...
    def pass_over(self, samples: int) -> None: ...

def follow_many(
    whole: NDArray[np.int64], real: NDArray[np.float64], u: NDArray[np.float64], counts: NDArray[np.int64]
) -> NDArray[np.int64]: ...
