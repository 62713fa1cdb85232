from typing import overload

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]

@overload
def simulate_servo(
    t: _Floats,
    goal: _Floats,
    values: _Floats,
    period: float,
    resolution: float,
    x0: float,
    v0: float,
    force: _Floats | None = None,
) -> tuple[_Floats, _Floats, float, None]: ...
@overload
def simulate_servo(
    t: _Floats,
    goal: _Floats,
    values: _Floats,
    period: float,
    resolution: float,
    x0: float,
    v0: float,
    force: _Floats | None,
    columns: NDArray[np.intp],
) -> tuple[_Floats, _Floats, float, _Floats]: ...
