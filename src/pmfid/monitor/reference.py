"""What a record of normal work says of the noise that no simulation of the model knows.

An encoder's error is differentiated: its blocks balance each other, and sums of many hardly grow. A force that no
equation explains does not: friction beyond the model's, a cable, a cutting force. So the deviations of sums of blocks
in the record are compared with those of the simulation, and where they are larger, the detectors are calibrated on the
record's own blocks, drawn anew in pieces (Künsch 1989; Politis and Romano 1994).
"""

from __future__ import annotations

import math

import numpy as np

from pmfid.types import Floats

#: Lengths of sums that are compared [blocks]; the longest is what the detectors look back on.
LENGTHS = (1, 2, 4, 8, 16, 32)
#: Blocks of a piece.
PIECE = 48
#: A power of the record counts where it is larger by so many standard errors, and at least so much.
LARGER, AT_LEAST = 3.0, 1.3


def powers(x: Floats, w: Floats, edge: float) -> tuple[Floats, Floats]:
    """Mean square of sums of blocks x, w: (runs, n, p), over their information; of each of LENGTHS, (lengths, p), and
    standard errors of that. Sums without information count for nothing; edge: as in `detectors`."""
    means, errors = [], []
    for length in LENGTHS:
        n = x.shape[1] // length * length
        sums = [part[:, :n].reshape(x.shape[0] * (n // length), length, x.shape[2]).sum(axis=1) for part in (x, w)]
        told = sums[1].mean(axis=1) > 0
        power = sums[0][told] ** 2 / (sums[1][told] + edge)
        count = max(1, len(power))
        means.append(power.mean(axis=0) if len(power) else np.ones(x.shape[2]))
        errors.append(power.std(axis=0) / math.sqrt(count) if len(power) else np.full(x.shape[2], np.inf))
    return np.array(means), np.array(errors)


def noisier(record: tuple[Floats, Floats], simulated: tuple[Floats, Floats], edge: float) -> bool:
    """Whether sums of blocks of the record x, w: (n, p) deviate by more than those of the simulation (runs, n, p)."""
    mean, error = powers(record[0][None], record[1][None], edge)
    normal, _ = powers(*simulated, edge)
    return bool(np.any(mean - np.maximum(LARGER * error, (AT_LEAST - 1) * normal) > normal))


def resampled(x: Floats, w: Floats, shape: tuple[int, int], rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Blocks (runs, n, p) of pieces of a record x, w: (n, p), from random places, each with a random sign: a deviation
    in either direction is as likely."""
    runs, n = shape
    pieces = -(-n // PIECE)
    starts = rng.integers(len(x), size=(runs, pieces, 1))
    rows = ((starts + np.arange(PIECE)) % len(x)).reshape(runs, -1)[:, :n]
    sign = np.repeat(rng.choice([-1.0, 1.0], size=(runs, pieces)), PIECE, axis=1)[:, :n, None]
    return sign * x[rows], w[rows]
