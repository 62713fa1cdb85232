"""How much a sum of scores scatters: what the error bars of an off-line estimate are made of.

A score is what one sample says that the parameters be moved by. Their sum is zero at the estimate; the estimate is as
uncertain as that sum would scatter from record to record. Neighbouring scores say nearly the same where something
slow is unexplained, friction above all, and noise of the counts on top of it hides that from a look at neighbours: so
sums over blocks are looked at, on every scale, and the largest scatter counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Blocks become longer as long as so many are left.
FEWEST = 24
TINY = 1e-300


def block_scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Variances (p,) of the sum of scores (n, p), as the scatter of their sums over blocks says (batch means: Fishman
    1978): the largest over blocks of `shortest`, twice that, and so on, as long as 24 of them are left.

    shortest: samples over which scores cancel each other, as the differences of a coarse count do.
    """
    n = scores.shape[0]
    length = max(1, min(shortest, n // FEWEST))
    largest = np.zeros(scores.shape[1])
    while length == 1 or n // length >= FEWEST:
        largest = np.maximum(largest, _blocks(scores, length).var(axis=0, ddof=1) * (n / length))
        length *= 2
    return largest


def scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Covariance (p, p) of the sum of scores (n, p): variances of `block_scatter`, correlations of its middle scale."""
    n = scores.shape[0]
    length = max(1, min(shortest, n // FEWEST), round(np.sqrt(n / FEWEST)))
    covariance = np.atleast_2d(np.cov(_blocks(scores, length), rowvar=False)) * (n / length)
    diagonal = np.maximum(np.diagonal(covariance), TINY)
    factor = np.sqrt(block_scatter(scores, shortest) / diagonal)
    return np.asarray(covariance * np.outer(factor, factor))


def _blocks(scores: Floats, length: int) -> Floats:
    """Sums (count, p) over blocks of `length` samples."""
    count = scores.shape[0] // length
    return np.asarray(scores[: count * length].reshape(count, length, -1).sum(axis=1))


def raised(covariance: Floats, variances: Floats) -> Floats:
    """A covariance (p, p) with its variances raised to at least `variances` (p,), correlations as they are."""
    diagonal = np.maximum(np.diagonal(covariance), TINY)
    factor = np.sqrt(np.maximum(variances / diagonal, 1.0))
    return np.asarray(covariance * np.outer(factor, factor))
