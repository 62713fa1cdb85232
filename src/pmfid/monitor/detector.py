"""The detector of a change, on standardised block deviations x and their information w (see `scores.Scale`).

The statistic is the generalised likelihood ratio (Willsky and Jones 1976) of the best start of a shift of any size: the
maximum of (|sum x| - tolerance sum w)^2 / (2 (sum w + EDGE)) over parameters and the last `WINDOW` starts. The module
`calibration` finds the values that the statistic may reach by chance. A block without information changes nothing. The
kernel `_stage.Detection` updates the state (rows, p) of each axis.
"""

from __future__ import annotations

import numpy as np

from pmfid._stage import Detection
from pmfid.types import Floats

#: Number of starts that are compared.
WINDOW = 32


def make_detection(p: int) -> Detection:
    """Return the recursion of the statistic for p parameters."""
    return Detection(p, WINDOW)


def start_detection(shape: tuple[int, ...]) -> Floats:
    """Return the state (..., rows, p) before the first block, for x of the shape (..., p)."""
    return np.zeros((*shape[:-1], make_detection(shape[-1]).rows, shape[-1]))


def statistics(x: Floats, w: Floats, tolerance: Floats, state: Floats | None = None) -> Floats:
    """Return the statistic (..., n) after each of the blocks x, w (..., n, p).

    `tolerance` (..., p) is the deviation that is no change, in standard deviations. A `state` (..., rows, p) is
    updated.
    """
    *many, n, p = x.shape
    axes, blocks = int(np.prod(many)), (-1, n, p)
    tolerances = np.broadcast_to(tolerance, (*many, p)).reshape(axes, p)
    own = (start_detection((*many, p)) if state is None else state).reshape(axes, -1, p)
    return make_detection(p).run(own, x.reshape(blocks), w.reshape(blocks), tolerances).reshape(*many, n)
