"""Samples for the self-test, and what the estimator makes of them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.estimators.base import check_arrays
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import configuration, shape_of, tight_state

SAMPLES = 800
#: Of the made-up motion: counts per sample at full speed, and the parts of the input that the frictions take.
COUNTS_PER_SAMPLE, VISCOUS_PART, COULOMB_PART = 40.0, 0.6, 0.3
#: And of the made-up linear process, for an input of one.
PROCESS_COUNTS = 500.0
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
    """Input and counts (n,) of a body that suits the axis; it reverses, rests, and its counter wraps."""
    if estimator.equation.process:
        return _made_up_process(estimator)
    full_speed = COUNTS_PER_SAMPLE * estimator.encoder.resolution / estimator.dt
    gain = estimator.equation.input_gain
    viscous, coulomb = VISCOUS_PART * abs(gain) / full_speed, COULOMB_PART * abs(gain)
    mass = viscous * 2 / estimator.cutoff
    u = _input(SAMPLES)
    from pmfid._kernel64 import simulate

    velocity, *_ = simulate([mass, viscous, viscous, coulomb, coulomb, 0.0, 0.0], gain, estimator.dt, u)
    position = np.concatenate([[0.0], np.cumsum(np.asarray(velocity)[:-1])]) * estimator.dt
    return u, np.floor(position / estimator.encoder.resolution).astype(np.int64) - 100


def _made_up_process(estimator: RecursiveEstimator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The same of lags one behind the other; some hundred counts."""
    u, y = _input(SAMPLES), []
    states, part = [0.0] * estimator.equation.order, min(0.5, estimator.cutoff * estimator.dt / 2)
    for value in u.tolist():
        y.append(states[-1])
        for i, source in enumerate([value, *states[:-1]]):
            states[i] += part * (source - states[i])
    return u, np.floor(PROCESS_COUNTS * np.asarray(y)).astype(np.int64)


def _input(samples: int) -> NDArray[np.float64]:
    """Levels between -1 and 1 by a shift register of five bits, and zero for a while."""
    register, levels = 0b10101, []
    for _ in range(samples // CLOCK + 1):
        register = register >> 1 | ((register ^ register >> 2) & 1) << 4
        levels.append((register - 15.5) / 15.5)
    u = np.repeat(levels, CLOCK)[:samples]
    u[samples // 2 : samples // 2 + REST] = 0.0
    return u


def recorded(estimator: RecursiveEstimator, u: ArrayLike, counts: ArrayLike) -> Samples:
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


def moving_part(u: NDArray[np.float64], counts: NDArray[np.int64]) -> slice:
    """The first samples of a record from shortly before it moves."""
    moves = np.flatnonzero(np.diff(counts))
    start = max(0, int(moves[0]) - 10) if moves.size else 0
    return slice(start, start + SAMPLES)
