"""Ages of the edges of an encoder, as the timer of a motor controller captures them."""

import numpy as np
from numpy.typing import ArrayLike

from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.simulation.drive import Motion
from pmfid.simulation.encoder import check_number, check_whole
from pmfid.types import Counts, Floats


def capture_edges(
    motion: Motion,
    resolution: float,
    phase: float = 0.0,
    *,
    every: int = 1,
    tick: float = 0.0,
    line_errors: ArrayLike = (0.0,),
) -> tuple[Counts, Floats]:
    """Return the counts of each sample, and the age of the last edge in each sample.

    Between the instants of the motion, the position is the cubic of both positions and velocities. For the example cart
    at 1 ms, the ages are exact to 1e-9 s, except in an interval with a stop or a turn. Simulate a motion with stops
    finely, and sample the motion with `every`. The edges in one interval of the motion follow from the net travel in
    this interval.

    Parameters
    ----------
    motion
        Simulated motion.
    resolution
        Travel per count [m], > 0.
    phase
        Start position on the encoder lattice [m].
    every
        Intervals of the motion per sample, >= 1.
    tick
        Period of the timer [s], >= 0; 0 means a timer without ticks.
    line_errors
        Distances of the lines from their even places [m], (lines,), each below half of the resolution. The errors
        repeat after this number of lines.

    Returns
    -------
    counts
        Counts at the samples, int64.
    ages
        Time from the last edge to the sample [s], in [0, every dt], or NaN without an edge since the previous sample.

    Raises
    ------
    ValueError
        If a value is outside its range.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.simulation import CART, capture_edges, simulate_drive
    >>> motion = simulate_drive(CART, np.full(100, 3.0), 1e-3)
    >>> counts, ages = capture_edges(motion, 1e-3, every=10)
    >>> counts.size, bool(np.nanmax(ages) <= 0.01)
    (10, True)
    """
    check_whole("every", every, 1, np.inf, "give the intervals of the motion per sample")
    check_number("tick", tick, remedy="give the period of the timer in s, or 0")
    if tick < 0.0:
        raise ValueError(f"tick must be >= 0, got {tick}; give the period of the timer in s, or 0")
    errors = np.atleast_1d(np.asarray(line_errors, np.float64))
    if errors.ndim != 1 or not np.all(np.abs(errors) < 0.5 * resolution):
        raise ValueError("line_errors must be an array (lines,) of distances below half of the resolution")
    path, lines = Trajectory(motion.t, motion.x, motion.v), Lattice(resolution, phase, errors)
    return read_edge_times(path, lines, every, tick)
