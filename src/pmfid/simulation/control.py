"""Position control of a drive through its encoder."""

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._plant import simulate_position_control
from pmfid.simulation.checks import check_number, check_signal, sample_times
from pmfid.simulation.drive import Drive, Motion, make_motion, make_schedule
from pmfid.simulation.encoder import NO_FAULTS, Faults, wrap_counts
from pmfid.types import Counts


def position_control(
    parameters: Drive,
    reference: ArrayLike,
    dt: float,
    *,
    kp: float,
    kd: float,
    u_max: float,
    resolution: float,
    phase: float = 0.0,
    bits: int | None = None,
    faults: Faults = NO_FAULTS,
) -> tuple[Motion, Counts]:
    """Return the motion and the counts (n,) of a drive whose PD controller sees only the encoder.

    y_k = resolution * counts_k,  counts_k = floor((x_k + phase) / resolution)   (paper eq. 3), or with `faults`
    u_k = kp (reference_k - y_k) - kd (y_k - y_{k-1}) / dt, limited to +-u_max, y_{-1} = y_0

    reference (n,) [m]; dt > 0 [s]; kp >= 0 [V/m]; kd >= 0 [V s/m]; u_max > 0 [V]; resolution > 0 [m];
    phase [m]. bits: width of the register that is returned; the controller itself counts on. Starts at rest at
    x = 0. There is no integral part: friction leaves an error of up to
    coulomb_friction / (input_gain kp). Raises ValueError for wrong arguments.
    """
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    for name, gain in (("kp", kp), ("kd", kd)):
        if not (np.isfinite(gain) and gain >= 0.0):
            raise ValueError(f"{name} must be finite and >= 0, got {gain}; reverse input_gain for a reversed motor")
    check_number("u_max", u_max, above=0.0, remedy="give the largest input in V")
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")
    target = check_signal("reference", reference)
    columns = make_schedule(parameters).sample(sample_times(target.size, dt), dt)
    x, v, direction, moving, u, counts = simulate_position_control(
        target, dt, *columns, 0.0, 0.0, kp, kd, u_max, resolution, phase, *faults.draw(target.size)
    )
    return make_motion(dt, u, x, v, direction, moving), wrap_counts(counts, bits)
