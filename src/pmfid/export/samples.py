"""Samples for the self-test, and what the estimator makes of them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.estimators.arguments import check_arrays
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import configuration, shape_of, tight_state

SAMPLES = 800
#: Samples between the changes of the made-up input, and samples of rest.
CLOCK, REST = 23, 150


@dataclass(frozen=True)
class Samples:
    """u: (n,) input; counts: (n,) as the counter shows them; expected: (n,) CRC-32 of the state after each; theta: (p,)
    after the last."""

    u: NDArray[np.floating]
    counts: NDArray[np.uint32]
    expected: NDArray[np.uint32]
    theta: NDArray[np.float64]


def made_up_record(estimator: RecursiveEstimator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Input and counts (n,) of a plant that suits the axis; a body reverses, rests, and its counter wraps."""
    u, axis = _input(SAMPLES), estimator
    return u, axis.plant.made_up_counts(axis.equation, u, axis.dt, axis.cutoff, axis.encoder.resolution)


def _input(samples: int) -> NDArray[np.float64]:
    """Levels between -1 and 1 by a shift register of five bits, and zero for a while."""
    register, levels = 0b10101, []
    for _ in range(samples // CLOCK + 1):
        register = register >> 1 | ((register ^ register >> 2) & 1) << 4
        levels.append((register - 15.5) / 15.5)
    u = np.repeat(levels, CLOCK)[:samples]
    u[samples // 2 : samples // 2 + REST] = 0.0
    return u


def record_run(estimator: RecursiveEstimator, u: ArrayLike, counts: ArrayLike) -> Samples:
    """Runs the estimator from its start over u, counts: (n,); the estimator's own state stays as it is.

    Raises UsageError for a record that is empty or not finite.
    """
    u, counts = check_arrays(u, counts)
    if u.size == 0 or not np.all(np.isfinite(u)):
        raise UsageError("the samples of the self-test must be finite, and at least one; take another record")
    kernel = estimator.make_kernel(estimator.forgetting)
    given = u.astype(kernel.dtype)
    shape = shape_of(configuration(kernel, estimator.precision))
    expected = []
    for value, count in zip(given.tolist(), counts.tolist(), strict=True):
        estimate = kernel.step(value, count)
        expected.append(zlib.crc32(tight_state(kernel, estimator.precision, shape).tobytes()))
    return Samples(given, counts.astype(np.uint32), np.array(expected, np.uint32), estimate.theta)


def moving_part(counts: NDArray[np.int64]) -> slice:
    """The first samples of a record from shortly before it moves."""
    moves = np.flatnonzero(np.diff(counts))
    start = max(0, int(moves[0]) - 10) if moves.size else 0
    return slice(start, start + SAMPLES)
