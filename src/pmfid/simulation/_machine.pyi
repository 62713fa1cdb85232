import numpy as np
from numpy.typing import NDArray

def simulate(
    command: NDArray[np.float64],
    dt: float,
    parameters: dict[str, float],
    dead_time: float,
    lag: float,
    noise: NDArray[np.float64],
    steps: int,
    kp: float,
    kd: float,
    u_max: float,
    resolution: float,
    phase: float,
    x0: float,
    v0: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]: ...
