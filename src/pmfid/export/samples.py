"""Samples of the self-test of an export."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.estimators.configuration import check_arrays
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import configuration, shape_of, tight_state

SAMPLES = 800
#: Number of samples between changes of the made-up input, and number of samples at rest.
CLOCK, REST = 23, 150


@dataclass(frozen=True)
class Samples:
    """Samples of the self-test.

    `u` (n,) is the input, and `counts` (n,) are the values of the counter. `expected` (n,) is the CRC-32 of the state
    after each sample. `theta` (p,) are the parameters after the last sample. `timing` (n,) are the times since the
    previous sample [s], or the ages of edges [s], or None for an even clock without edges.
    """

    u: NDArray[np.floating]
    counts: NDArray[np.uint32]
    expected: NDArray[np.uint32]
    theta: NDArray[np.float64]
    timing: NDArray[np.floating] | None = None


def made_up_record(estimator: RecursiveEstimator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return input and counts (n,) of a plant that suits the axis. A body reverses and rests, and its counter wraps."""
    u, axis = make_up_input(), estimator
    return u, axis.plant.made_up_counts(axis.equation, u, axis.dt, axis.cutoff, axis.encoder.resolution)


def make_up_input() -> NDArray[np.float64]:
    """Return `SAMPLES` levels between -1 and 1 from a shift register of five bits, with a stretch of zeros."""
    register, levels = 0b10101, []
    for _ in range(SAMPLES // CLOCK + 1):
        register = register >> 1 | ((register ^ register >> 2) & 1) << 4
        levels.append((register - 15.5) / 15.5)
    u = np.repeat(levels, CLOCK)[:SAMPLES]
    u[SAMPLES // 2 : SAMPLES // 2 + REST] = 0.0
    return u


def record_run(estimator: RecursiveEstimator, u: ArrayLike, counts: ArrayLike) -> Samples:
    """Run the estimator from its start over u (n,) and counts (n,), without a change of the estimator's state.

    Raises UsageError for a record that is empty or not finite.
    """
    u, counts = check_arrays(u, counts)
    if u.size == 0 or not np.all(np.isfinite(u)):
        raise UsageError("the samples of the self-test must be finite, and at least one; take another record")
    kernel = estimator.make_kernel(estimator.forgetting)
    given = u.astype(kernel.dtype)
    uneven = np.asarray(estimator.dt * (0.5 + 7 * np.arange(u.size) % 16 / 15), kernel.dtype)
    steps = None if estimator.steps is None else uneven
    shape = shape_of(configuration(kernel, estimator.precision))
    expected = []
    for value, count, step in zip(
        given.tolist(), counts.tolist(), [None] * u.size if steps is None else steps.tolist(), strict=True
    ):
        estimate = kernel.step(value, count, step)
        expected.append(zlib.crc32(tight_state(kernel, estimator.precision, shape).tobytes()))
    return Samples(given, counts.astype(np.uint32), np.array(expected, np.uint32), estimate.theta, steps)


def moving_part(counts: NDArray[np.int64]) -> slice:
    """Return the first SAMPLES samples of a record, from shortly before its first motion."""
    moves = np.flatnonzero(np.diff(counts))
    start = max(0, int(moves[0]) - 10) if moves.size else 0
    return slice(start, start + SAMPLES)
