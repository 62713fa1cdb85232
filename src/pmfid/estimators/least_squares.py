"""Solutions of least squares, their rank and scale, and the level of the output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.results import Columns
from pmfid.models.equation import Equation

NO_SOLUTION = (
    "the equations for the parameters have no unique solution: the excitation is too poor; "
    "record reversals, and varying speeds and accelerations"
)


def solve_with_instruments(columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return theta = (sum zeta phi^T)^-1 sum zeta z (p,) and the inverse (p, p) in this formula. An orthogonal
    decomposition of the instruments avoids the square of their condition number."""
    scale = np.linalg.norm(columns.zeta, axis=0)
    Q, R = np.linalg.qr(columns.zeta / scale)
    inverse = inverse_of(Q.T @ columns.phi)
    with np.errstate(all="ignore"):  # an overflow is checked below
        theta, gain = inverse @ (Q.T @ columns.z), inverse @ inverse_of(R.T) / scale
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(gain))):
        raise NotIdentifiableError(NO_SOLUTION)
    return theta, gain


def solve_bounded(columns: Columns, positive: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the least squares (p,) in which no parameter marked by `positive` (p,) is negative (Lawson and Hanson
    1974).
    """
    from scipy.optimize import nnls  # the import is slow and seldom needed

    size = np.maximum(np.linalg.norm(columns.phi, axis=0), np.finfo(float).tiny)
    scaled = columns.phi / size
    found = nnls(np.hstack([scaled, -scaled[:, ~positive]]), columns.z)[0]
    found[: positive.size][~positive] -= found[positive.size :]
    return np.asarray(found[: positive.size] / size)


def inverse_of(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a matrix (p, p). Raises NotIdentifiableError for a singular matrix or an inverse with
    infinite entries."""
    try:
        with np.errstate(all="ignore"):  # an overflow is checked below
            inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise NotIdentifiableError(NO_SOLUTION)
    return np.asarray(inverse)


def long_run_covariance(scores: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """Return the covariance (p, p) of summed correlated scores (n, p) with Bartlett's window (Newey and West 1987)."""
    n = scores.shape[0]
    size = 2 ** int(np.ceil(np.log2(n + lags + 1)))
    spectrum = np.fft.rfft(scores, size, axis=0)
    window = np.maximum(0.0, 1 - np.arange(lags + 1) / (lags + 1))
    lagged = np.fft.irfft(spectrum[:, :, None] * spectrum.conj()[:, None, :], size, axis=0)[: min(lags + 1, n)]
    total = np.tensordot(window[: lagged.shape[0]], lagged, axes=1)
    covariance = np.asarray(total + total.T - lagged[0])
    return np.asarray((covariance + covariance.T) / 2)


def parts_of_their_own(
    sensitivity: NDArray[np.float64], rcond: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the independent part (p,) of each column of `sensitivity` (n, p), and the pseudo-inverse (p, n).

    The independent part, from 0 to 1, is the part of a column that no combination of the other columns gives. The
    independent part is 0 for a column of zeros, and 0 for all columns if one column overflows. The pseudo-inverse is
    that of the columns scaled to length 1. `rcond` is the argument of `numpy.linalg.pinv`.
    """
    with np.errstate(over="ignore"):  # an overflow is checked below
        size = np.linalg.norm(sensitivity, axis=0)
    huge = ~np.isfinite(size)
    if np.any(huge):  # the squares or the column itself overflow
        largest = np.max(np.abs(sensitivity[:, huge]), axis=0)
        if not np.all(np.isfinite(largest)):
            return np.zeros(size.size), np.zeros(sensitivity.shape[::-1])
        size[huge] = largest * np.linalg.norm(sensitivity[:, huge] / largest, axis=0)
    scaled = sensitivity / np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(scaled) if rcond is None else np.linalg.pinv(scaled, rcond=rcond)
    parts = 1 / np.maximum(np.linalg.norm(inverse, axis=1), 1.0)
    parts[size == 0] = 0.0
    return np.asarray(parts), np.asarray(inverse)


@dataclass(frozen=True)
class Level:
    """Indices of the parameters that contain the output's level.

    The equation of y also holds for y - first, with the constant theta[constant] - ratio * first * theta[lowest].
    `lowest` is None if no term contains the output itself; the constant is then the same.
    """

    constant: int
    lowest: int | None
    ratio: float


def level_of(equation: Equation) -> Level | None:
    """Return the output's level in the equation, or None if the equation does not hold for y - first. The equation does
    not hold for y - first without an unknown constant, or with a term for the plant's start."""
    unknown = [(term.signal, term.derivative) for term in equation.unknown]
    known = {term.signal for term in equation.known}
    if ("constant", 0) not in unknown or "constant" in known or any(signal == "start" for signal, _ in unknown):
        return None
    if any((term.signal, term.derivative) == ("process_output", 0) for term in equation.known):
        return None
    if not any(signal == "process_output" for signal, _ in unknown):
        return None
    constant = unknown.index(("constant", 0))
    if ("process_output", 0) not in unknown:
        return Level(constant, None, 0.0)
    lowest = unknown.index(("process_output", 0))
    ratio = -equation.unknown[lowest].coefficient / equation.unknown[constant].coefficient
    return Level(constant, lowest, ratio)
