"""How much a sum of scores scatters: what the error bars of an off-line estimate are made of.

A score is what one sample says that the parameters be moved by: by the parameter, not before the inverse that makes
one out of the sums, for what scatters most there may move no parameter. Their sum is zero at the estimate; the estimate
is as uncertain as that sum would scatter from record to record. Neighbouring scores say nearly the same where something
slow is unexplained, friction above all, and noise of the counts on top of it hides that from a look at neighbours: so
sums over blocks are looked at, on every scale, and the largest scatter counts.

The blocks fade in and out. After a filter that differentiates, the noise of the counts cancels over a block but for
its two ends, and blocks with sharp ends would show nothing else.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmfid.types import Floats

#: Blocks of the longest scale, at least.
FEWEST = 24
TINY = 1e-300
#: Width of the difference quotients that are compared with the fine ones, as a part of a parameter.
COARSE = 1e-2
#: Factor between variances beyond which the dependence is not smooth.
SMOOTH = 4.0
#: Further widths for a rough dependence.
WIDTHS = (1e-3, 3e-2, 0.1, 0.3)


def block_scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Variances (p,) of the sum of scores (n, p), as the scatter of their sums over blocks says (tapered segments that
    overlap by half: Welch 1967): the largest over blocks of `shortest`, twice that, and so on, as long as 24 of them
    are left.

    shortest: samples over which scores cancel each other, as the differences of a coarse count do.
    """
    n = scores.shape[0]
    length = max(1, min(shortest, n // FEWEST))
    largest = np.zeros(scores.shape[1])
    while length == 1 or n // length >= FEWEST:
        largest = np.maximum(largest, np.mean(_blocks(scores, length) ** 2, axis=0) * (n**2 / (n - length)))
        length *= 2
    return largest


def scatter(scores: Floats, shortest: int = 1) -> Floats:
    """Covariance (p, p) of the sum of scores (n, p): variances of `block_scatter`, correlations of its middle scale."""
    n = scores.shape[0]
    length = max(1, min(shortest, n // FEWEST), round(np.sqrt(n / FEWEST)))
    sums = _blocks(scores, length)
    covariance = sums.T @ sums * (n / sums.shape[0])
    diagonal = np.maximum(np.diagonal(covariance), TINY)
    factor = np.sqrt(block_scatter(scores, shortest) / diagonal)
    return np.asarray(covariance * np.outer(factor, factor))


def _blocks(scores: Floats, length: int) -> Floats:
    """Sums (count, p) of scores less their mean over blocks of `length` samples, each beginning in the middle of the
    one before, with weights that are zero at their ends and of squares that add up to 1."""
    weight = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    weight /= np.linalg.norm(weight)
    around = scores - scores.mean(axis=0)
    windows = np.lib.stride_tricks.sliding_window_view(around, length, axis=0)[:: max(1, length // 2)]
    return np.asarray(windows @ weight)


def raise_variances(covariance: Floats, variances: Floats) -> Floats:
    """A covariance (p, p) with its variances raised to at least `variances` (p,), correlations as they are."""
    diagonal = np.maximum(np.diagonal(covariance), TINY)
    factor = np.sqrt(np.maximum(variances / diagonal, 1.0))
    return np.asarray(covariance * np.outer(factor, factor))


def widen_covariance(covariance: Floats, at: Callable[[float], Floats]) -> Floats:
    """A covariance (p, p) of fine difference quotients, raised to the variances of wider ones if these are larger.

    A body with friction sticks and breaks away: the simulated motion jumps where a parameter crosses the value at which
    one more stroke happens. A fine quotient across such a jump takes the parameter for known to the quotient's width,
    though a change ten times as large may explain the record as well. A smooth dependence gives the same variances at
    every width; for a rough one the largest counts. `at` gives the covariance at a width. Raises what `at` raises.
    """
    variances, coarse = np.diagonal(covariance), np.diagonal(at(COARSE))
    if np.all((coarse < SMOOTH * variances) & (variances < SMOOTH * coarse)):
        return covariance
    return raise_variances(covariance, np.max([coarse, *(np.diagonal(at(width)) for width in WIDTHS)], axis=0))
