import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]

def simulate_open_loop(
    u: _Floats,
    dt: float,
    mass: _Floats,
    viscous: _Floats,
    coulomb: _Floats,
    input_gain: _Floats,
    offset: _Floats,
    x0: float,
    v0: float,
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
def simulate_position_control(
    reference: _Floats,
    dt: float,
    mass: _Floats,
    viscous: _Floats,
    coulomb: _Floats,
    input_gain: _Floats,
    offset: _Floats,
    x0: float,
    v0: float,
    kp: float,
    kd: float,
    u_max: float,
    resolution: float,
    phase: float,
    lines: _Floats,
    shift: _Floats,
    missed: float,
    seed: int,
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, NDArray[np.int64]]: ...
def read_encoder(
    x: _Floats,
    resolution: float,
    phase: float,
    lines: _Floats,
    shift: _Floats,
    missed: float,
    seed: int,
) -> NDArray[np.int64]: ...
