import numpy as np
from numpy.typing import ArrayLike, NDArray

def first_order(
    signal: ArrayLike, a: float, b0: float, b1: float = 0.0, memory: float = 0.0
) -> tuple[NDArray[np.float64], float]: ...
