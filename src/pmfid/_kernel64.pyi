from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmfid._estimate import Estimate as Estimate

class Kernel:
    dtype: np.dtype[np.floating]
    max_parameters: int
    names: tuple[str, ...]
    @property
    def straight(self) -> bool: ...
    @straight.setter
    def straight(self, wanted: bool) -> None: ...
    def __init__(self, config: bytes) -> None: ...
    def reset(self) -> None: ...
    def open(self, keep: float, parameter: int = -1) -> None: ...
    def rebase(self, counts: int) -> None: ...
    def gap(self, counts: int) -> None: ...
    def doubt(self, samples: int) -> None: ...
    def step(self, u: float, counts: int, dt: float | None = None) -> Estimate: ...
    def estimate(self) -> Estimate: ...
    def run(
        self, u: NDArray[np.float64], counts: NDArray[np.int64], steps: NDArray[np.float64] | None = None
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.uint32],
    ]: ...
    def filter(
        self, u: NDArray[np.float64], counts: NDArray[np.int64], steps: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.uint32]]: ...
    def score(
        self,
        u: NDArray[np.float64],
        counts: NDArray[np.int64],
        scoring: tuple[int, int, int, int, int],
        theta: NDArray[np.float64],
        sums: NDArray[np.float64],
        progress: NDArray[np.uint32],
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]: ...
    def many(self, axes: int, is_whole: bytes) -> ManyKernel: ...
    def raw_config(self) -> bytes: ...
    def raw_state(self, kept: bool = False) -> bytes: ...
    def set_raw_state(self, state: bytes) -> None: ...

class ManyKernel:
    fastest_way: int
    states: NDArray[np.uint8]
    def __init__(self, kernel: Kernel, axes: int, is_whole: bytes) -> None: ...
    @property
    def side_by_side(self) -> bool: ...
    def load(self, kernel: Kernel, axis: int) -> None: ...
    def store(self, kernel: Kernel, axis: int) -> None: ...
    def hold(self, states: NDArray[np.uint8]) -> None: ...
    def plausible(self) -> bool: ...
    def gap(self, axis: int, counts: int) -> None: ...
    def score(
        self,
        u: NDArray[np.float64],
        counts: NDArray[np.int64],
        scoring: tuple[int, int, int, int, int],
        theta: NDArray[np.float64],
        sums: NDArray[np.float64],
        progress: NDArray[np.uint32],
        way: int | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]: ...
    def run(
        self,
        u: NDArray[np.floating],
        counts: NDArray[np.integer],
        first: int,
        end: int,
        every: int,
        results: Sequence[NDArray[np.float64] | NDArray[np.uint32]],
        way: int,
    ) -> None: ...
    def reset(self) -> None: ...
    def raw_config(self) -> bytes: ...
    def set_states(self, states: NDArray[np.uint8]) -> None: ...
    packing: int
    def older_size(self, packing: int, is_whole: bytes) -> int: ...
    def repack(
        self, states: NDArray[np.uint8], packing: int, is_whole: bytes, back: bool = False
    ) -> NDArray[np.uint8]: ...

def simulate_many(
    parameters: NDArray[np.float64] | Sequence[Sequence[float]],
    input_gain: float,
    dt: float,
    u: NDArray[np.float64],
    velocity: NDArray[np.float64] | Sequence[float],
    position: NDArray[np.float64] | Sequence[float],
    shapes: bytes = b"",
    before: NDArray[np.float64] | Sequence[float] = (0.0,),
    decay: Sequence[Sequence[tuple[float, float, float]]] | None = None,
    on_top: NDArray[np.float64] | None = None,
    hold: int = 1,
    parts: int = 1,
    sides: bool = False,
    steps: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.float64]]: ...
def simulate(
    parameters: Sequence[float],
    input_gain: float,
    dt: float,
    u: NDArray[np.float64],
    velocity: float = 0.0,
    position: float = 0.0,
    shapes: bytes = b"",
    before: NDArray[np.float64] | Sequence[float] = (0.0,),
    decay: Sequence[tuple[float, float, float]] | None = None,
    on_top: NDArray[np.float64] | None = None,
    steps: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]: ...

class EdgeKernel:
    def __init__(
        self,
        names: tuple[str, ...],
        dt: float,
        resolution: float,
        input_gain: float,
        tick: float,
        memory: float,
        lines: int,
        sign: int,
    ) -> None: ...
    def reset(self) -> None: ...
    def expect(self, theta: NDArray[np.float64]) -> None: ...
    def raw_config(self) -> bytes: ...
    def raw_state(self) -> bytes: ...
    def set_raw_state(self, data: bytes) -> None: ...
    def estimate(self) -> Estimate: ...
    def step(self, u: float, counts: int, age: float) -> Estimate: ...
    def run(
        self, u: NDArray[np.float64], counts: NDArray[np.int64], ages: NDArray[np.float64]
    ) -> tuple[
        NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]
    ]: ...
    def run_many(
        self,
        states: NDArray[np.uint8],
        u: NDArray[np.float64],
        counts: NDArray[np.int64],
        ages: NDArray[np.float64],
    ) -> tuple[
        NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]
    ]: ...
