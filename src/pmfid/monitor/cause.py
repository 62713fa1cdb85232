"""What changed, by how much and since when: the one cause that explains the block scores best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.monitor.scores import Blocks, Floats, Scale

#: A drive that gives less force looks as if all parameters had grown alike.
INPUT_GAIN = "input_gain"
#: Keeps the instruments of a few blocks apart.
RIDGE = 1e-6


@dataclass(frozen=True)
class Cause:
    """name: of the parameter, or INPUT_GAIN; change, std: [its unit]; relative: change over the reference value; start:
    index of the first block that shows it; share: of all that a change of all parameters together would explain."""

    name: str
    change: float
    std: float
    relative: float
    start: int
    share: float


def explain(blocks: Blocks, scale: Scale, theta: Floats, names: Sequence[str], input_gain: float) -> Cause:
    """The single change at one of the blocks' starts that takes most from the error of the equation.

    For a direction v and the blocks from a start on, with sums S, W, Z,

        gain = (v^T W^T Z^-1 S)^2 / (v^T W^T Z^-1 W v)

    is the generalised likelihood ratio of theta0 + size v (Willsky and Jones 1976), but for the noise. theta: (p,)
    reference; directions: each parameter, and theta itself for a loss of force.
    """
    S, W, Z = (np.cumsum(part[::-1], axis=0)[::-1] for part in (blocks.score, blocks.cross, blocks.square))
    Z = Z + RIDGE * np.diag(np.diagonal(Z[0]))
    directions = np.vstack([np.eye(theta.size), theta])
    weighted = np.linalg.solve(Z, W @ directions.T)  # (n, p, directions)
    match = np.einsum("npd,np->nd", weighted, S)
    known = np.maximum(np.einsum("npd,npd->nd", weighted, W @ directions.T), np.finfo(float).tiny)
    gain = match**2 / known
    # of equal starts the last: what no block could show did not begin yet
    late = gain[::-1]
    start = len(gain) - 1 - int(np.argmax(late.max(axis=1) >= (1 - 1e-9) * late.max()))
    which = int(np.argmax(gain[start]))
    noise = scale.sigma**2 / scale.energy
    variance = (noise[which] if which < theta.size else float(np.mean(noise))) / known[start, which]
    size, std = float(match[start, which] / known[start, which]), float(np.sqrt(variance))
    share = float(gain[start, which] / max(S[start] @ np.linalg.solve(Z[start], S[start]), np.finfo(float).tiny))
    if which < theta.size:
        return Cause(names[which], size, std, size / abs(float(theta[which])), start, share)
    factor = 1 / max(1 + size, 0.01)
    relative = factor - 1
    return Cause(INPUT_GAIN, relative * input_gain, std * factor**2 * abs(input_gain), relative, start, share)
