"""Elementary functions with the same bits on every processor.

NumPy, BLAS and the C library choose their code by the processor, and each variant rounds differently. The constants of
the kernel decide the bits of estimates, of firmware and of saved states, so they must not depend on such a choice.
The functions of one number compute with 60 decimal digits and round once. The functions of arrays use only sums,
products and quotients of single elements, which IEEE 754 defines to the last bit.
"""

from __future__ import annotations

import math
from decimal import Context, Decimal

import numpy as np

from pmfid.types import Floats

#: Arithmetic with far more digits than a double, so that the last rounding is almost always the only one.
PRECISE = Context(prec=60, Emin=-999999, Emax=999999, traps=[])


def exp(x: float) -> float:
    """Return exp(x), infinite above the range of a double."""
    return float(PRECISE.exp(Decimal(x)))


def expm1(x: float) -> float:
    """Return exp(x) - 1 without loss of digits near x = 0, where x is the nearest double."""
    return x if abs(x) < 1e-20 else float(PRECISE.subtract(PRECISE.exp(Decimal(x)), Decimal(1)))


def log(x: float) -> float:
    """Return the natural logarithm of x > 0."""
    return float(PRECISE.ln(Decimal(x)))


def tanh(x: float) -> float:
    """Return the hyperbolic tangent of x, for which x is the nearest double near x = 0."""
    if abs(x) < 1e-20:
        return x
    decay = PRECISE.exp(Decimal(-2 * abs(x)))
    return math.copysign(float(PRECISE.divide(PRECISE.subtract(Decimal(1), decay), PRECISE.add(Decimal(1), decay))), x)


def power(base: float, exponent: float) -> float:
    """Return base > 0 to the power of any exponent."""
    return float(PRECISE.power(Decimal(base), Decimal(exponent)))


def geometric(first: float, last: float, n: int) -> Floats:
    """Return n > 1 numbers (n,) from `first` to `last` > 0 with a constant ratio."""
    steps = np.full(n, power(last / first, 1 / (n - 1)))
    steps[0] = first
    row = np.cumprod(steps)
    row[-1] = last
    return row


def line_through(x: Floats, y: Floats) -> tuple[float, float]:
    """Return slope and value at x = 0 of the line of least squares through the points (n,), n > 1."""
    middle, height = np.mean(x), np.mean(y)
    around = x - middle
    slope = np.sum(around * (y - height)) / np.sum(around * around)
    return float(slope), float(height - slope * middle)


def solve(A: Floats, b: Floats) -> Floats:
    """Return x (n,) with A x = b by Gaussian elimination with partial pivoting, for a few unknowns.

    Raises ZeroDivisionError for a singular A (n, n).
    """
    rows = [[*row, right] for row, right in zip(A.tolist(), b.tolist(), strict=True)]
    n = len(rows)
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [left - factor * right for left, right in zip(rows[i], rows[k], strict=True)]
    x = [0.0] * n
    for k in reversed(range(n)):
        total = rows[k][n]
        for i in range(k + 1, n):
            total -= rows[k][i] * x[i]
        x[k] = total / rows[k][k]
    return np.array(x)


def cos_sin(turns: Floats) -> tuple[Floats, Floats]:
    """Return cosine and sine (n,) of angles (n,) in turns, with an absolute error below 2e-15 for |turns| <= 1/2.

    The series of a small angle gives the sine s and v = 1 - cos. Doubling the angle takes (s, v) to (2 s (1 - v),
    2 s^2).
    """
    doublings = 6
    angle = 2 * math.pi * (turns - np.rint(turns)) / 2**doublings
    square = angle * angle
    s, v = np.ones_like(angle), np.ones_like(angle)
    for k in (8, 6, 4, 2):
        s, v = 1 - square / (k * (k + 1)) * s, 1 - square / ((k + 1) * (k + 2)) * v
    s, v = angle * s, square / 2 * v
    for _ in range(doublings):
        s, v = 2 * s * (1 - v), 2 * s * s
    return 1 - v, s
