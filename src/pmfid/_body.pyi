import numpy as np
from numpy.typing import NDArray

BASE: int
LOOP: int
ELASTIC_BASE: int
KINDS: dict[str, int]

def run(
    forces: list[tuple[int, int, bool, NDArray[np.float64], float, float, bool]],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    row: NDArray[np.int32],
    columns: NDArray[np.float64],
    theta: NDArray[np.float64],
    parts: int,
    lift: NDArray[np.float64] | None,
    tick: float = 0.0,
    on: NDArray[np.float64] | None = None,
    elastic: bool = False,
    load: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]: ...
def drive_load(
    x: NDArray[np.float64], step: float, substeps: int, loads: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def whiten(
    X: NDArray[np.float64],
    step: NDArray[np.float64],
    variance: NDArray[np.float64],
    rate: float,
    force: tuple[float, float],
    position: tuple[float, float],
) -> float: ...
