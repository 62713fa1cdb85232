"""Noise of a record of normal work that a simulation of the model does not have.

An encoder's error is differentiated: its blocks balance each other, and sums of many hardly grow. A force that no
equation explains does not: friction beyond the model's, a cable, a cutting force. So the deviations of sums of blocks
in the record are compared with deviations in the simulation. If they are larger, the detectors take units of work
(`work`), and are calibrated on pieces drawn from the record's units (Künsch 1989; Politis and Romano 1994).
"""

from __future__ import annotations

import math

import numpy as np

from pmfid.types import Floats

#: Lengths of sums that are compared [blocks]; the longest is what the detectors look back on.
LENGTHS = (1, 2, 4, 8, 16, 32)
#: Units of a piece, and what more of them may change the variance of their sum by.
PIECES, SAME = (1, 2, 4, 8, 16), 0.1
#: Excess of a record's power over the simulated one that counts: in standard errors, and as a ratio.
LARGER, AT_LEAST = 3.0, 1.3


def powers(x: Floats, w: Floats, edge: float) -> tuple[Floats, Floats]:
    """Mean square of sums of blocks x, w: (runs, n, p), over their information; of each of LENGTHS, (lengths, p), and
    standard errors of that. Sums without information count for nothing; edge: as in `detectors`."""
    means, errors = [], []
    for length in LENGTHS:
        n = x.shape[1] // length * length
        sums = [part[:, :n].reshape(x.shape[0] * (n // length), length, x.shape[2]).sum(axis=1) for part in (x, w)]
        informed = sums[1].mean(axis=1) > 0
        power = sums[0][informed] ** 2 / (sums[1][informed] + edge)
        count = max(1, len(power))
        means.append(power.mean(axis=0) if len(power) else np.ones(x.shape[2]))
        errors.append(power.std(axis=0) / math.sqrt(count) if len(power) else np.full(x.shape[2], np.inf))
    return np.array(means), np.array(errors)


def noisier(record: tuple[Floats, Floats], simulated: tuple[Floats, Floats], edge: float) -> bool:
    """Whether sums of blocks of the record x, w: (n, p) deviate by more than those of the simulation (runs, n, p)."""
    mean, error = powers(record[0][None], record[1][None], edge)
    normal, _ = powers(*simulated, edge)
    return bool(np.any(mean - np.maximum(LARGER * error, (AT_LEAST - 1) * normal) > normal))


def piece_length(x: Floats) -> int:
    """Number of units of a piece of x (n, p), so that pieces keep the correlation of neighbouring units.

    It is the smallest number whose sums have, per unit and within chance, the variance of sums of four times as many.
    """
    for length in PIECES[:-1]:
        n = len(x) // (4 * length)
        chance = 2 * math.sqrt(2 / max(n, 1))
        short, long = (_variance(x, pieces) for pieces in (length, 4 * length))
        if np.all(np.abs(long / short - 1) <= max(SAME, chance)):
            return length
    return PIECES[-1]


def _variance(x: Floats, length: int) -> Floats:
    """(p,) of sums of `length` of x (n, p), for each of them."""
    n = len(x) // length * length
    if n == 0:
        return np.ones(x.shape[1])
    return np.asarray((x[:n].reshape(-1, length, x.shape[1]).sum(axis=1) ** 2).mean(axis=0) / length)


def resample_units(
    x: Floats, w: Floats, shape: tuple[int, int], length: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Units (runs, n, p) of pieces of `length` of a record x, w: (n, p), from random places.

    Mean and standard deviation of each run come from a second record of the original length, drawn in the same way. So
    their errors are those of such a record.
    """
    drawn = _rows(len(x), shape, length, rng)
    learned = _rows(len(x), (shape[0], len(x)), length, rng)
    mean = x[learned].sum(axis=1) / w[learned].sum(axis=1)
    std = np.sqrt(((x[learned] - w[learned] * mean[:, None]) ** 2).mean(axis=1))
    return (x[drawn] - w[drawn] * mean[:, None]) / std[:, None], w[drawn]


def _rows(n: int, shape: tuple[int, int], length: int, rng: np.random.Generator) -> np.ndarray:
    """(runs, n) places in a record of n."""
    starts = rng.integers(n, size=(shape[0], -(-shape[1] // length), 1))
    return np.asarray(((starts + np.arange(length)) % n).reshape(shape[0], -1)[:, : shape[1]])
