"""Simulated output of a linear process, its sensitivities, and the filtered output, on one stretch of a record.

With A(s) = s^n + a_{n-1} s^{n-1} + ... + a_0 and B(s) = b_0 + ... + b_m s^m the output is

    y = B/A u + offset/A 1 + C/A delta,

C/A delta the response to the unknown initial conditions (paper eq. 10). The filter 1/A(s) acts on all signals; as
A/A = 1, the equation error at the true parameters is the output's noise at the samples, whatever y does between them:
so there is no error of discretisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.linear.experiment import Stretch
from pmfid.linear.propagate import respond

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """n poles, m zeros, with or without a constant beside the input."""

    n: int
    m: int
    offset: bool = False

    @property
    def size(self) -> int:
        return self.n + self.m + 1 + self.offset

    def split(self, theta: Floats) -> tuple[Floats, Floats, float]:
        """a (n,), b (m + 1,), offset."""
        b = theta[self.n : self.n + self.m + 1]
        return theta[: self.n], b, float(theta[-1]) if self.offset else 0.0

    def scale(self, rate: float) -> Floats:
        """(p,) factors from parameters in time units of 1/rate to parameters in seconds."""
        powers = [self.n - i for i in range(self.n)] + [self.n - j for j in range(self.m + 1)]
        return np.asarray(rate ** np.array(powers + [self.n] * self.offset, float))


@dataclass(frozen=True)
class Linearised:
    """On r measured samples: error (r,) y minus the simulated output; phi (r, p) regressors from the data, zeta (r, p)
    from the simulated output alone, its sensitivities; free (r, n) responses to the initial conditions."""

    error: Floats
    phi: Floats
    zeta: Floats
    free: Floats


def companion(a: Floats) -> Floats:
    """F of the states s^i / A(s) w, i < n."""
    F = np.diag(np.ones(a.size - 1), 1)
    F[-1] = -a
    return F


def channels(structure: Structure, a: Floats, stretch: Stretch, *, twice: bool) -> Floats:
    """(n, channels, M): s^k / A(s), k < n, of the inputs, a constant 1 (with offset) and an impulse; twice: beneath
    them s^k / A(s)^2, k < 2n - 1."""
    n, size = structure.n, stretch.grid.size
    w = np.vstack([stretch.inputs, np.ones((int(structure.offset), size)), np.zeros((1, size))])
    start = np.zeros((2 * n if twice else n, w.shape[0]))
    start[n - 1, -1] = 1.0
    F = companion(a)
    if not twice:
        return respond(F, np.eye(n)[-1], stretch.grid, w, start, held=stretch.held)
    both = np.block([[F, np.zeros((n, n))], [np.zeros((n, n)), F]])
    both[-1, 0] = 1.0
    states = respond(both, np.eye(2 * n)[n - 1], stretch.grid, w, start, held=stretch.held)
    double = list(states[n:])
    for r in range(n - 1):
        double.append(states[r] - sum(a[k] * double[r + k] for k in range(n)))
    return np.concatenate([states[:n], np.array(double)])


def linearise(structure: Structure, theta: Floats, initial: Floats, stretch: Stretch) -> Linearised:
    """At theta (p,), with initial conditions (n,) of the stretch; time in the unit of the stretch."""
    n = structure.n
    a, b, offset = structure.split(theta)
    states = channels(structure, a, stretch, twice=True)
    single, double = states[:n], states[n:]
    simulated = b @ single[: b.size, 0] + initial @ single[:, -1]
    if structure.offset:
        simulated = simulated + offset * single[0, -2]
    source = stretch.inputs.shape[0] - 1  # the reference, where there is one
    slopes = [b @ double[i : i + b.size, source] + initial @ double[i : i + n, -1] for i in range(n)]
    zeta_a = np.array(slopes) + (offset * double[:n, -2] if structure.offset else 0.0)
    filtered = respond(companion(a), np.eye(n)[-1], stretch.grid, stretch.y[None], np.zeros((n, 1)), held=False)[:, 0]
    constant = single[:1, -2] if structure.offset else single[:0, -2]
    rows = stretch.rows
    return Linearised(
        (stretch.y - simulated)[rows],
        np.vstack([-filtered, single[: b.size, 0], constant])[:, rows].T,
        np.vstack([-zeta_a, single[: b.size, source], constant])[:, rows].T,
        single[:, -1][:, rows].T,
    )


def simulate(
    structure: Structure, theta: Floats, initial: Floats, stretch: Stretch, *, source: int | None = None
) -> Floats:
    """Output (M,) from the initial conditions (n,) and an input alone: `source` of the stretch's, None: what
    instruments are made from."""
    a, b, offset = structure.split(theta)
    states = channels(structure, a, stretch, twice=False)
    source = stretch.inputs.shape[0] - 1 if source is None else source
    constant = offset * states[0, -2] if structure.offset else 0.0
    return np.asarray(b @ states[: b.size, source] + initial @ states[:, -1] + constant)


def stable(a: Floats, duration: float) -> Floats:
    """a with poles in the right half-plane reflected; those that hardly grow within the duration may stay."""
    poles = np.roots(np.r_[1.0, a[::-1]])
    bad = poles.real * duration > 1.0
    if not np.any(bad):
        return a
    mirrored = np.where(bad, -poles.real, poles.real) + 1j * poles.imag
    return np.asarray(np.poly(mirrored).real[:0:-1])
