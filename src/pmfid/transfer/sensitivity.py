"""Simulated output of a linear process, its sensitivities, and the filtered output, on one stretch of a record.

With A(s) = s^n + a_{n-1} s^{n-1} + ... + a_0 and B(s) = b_0 + ... + b_m s^m the output is

    y = B/A u + offset/A 1 + C/A delta,

C/A delta the response to the unknown initial conditions (paper eq. 10). The filter 1/A(s) acts on all signals; as
A/A = 1, the equation error at the true parameters is the output's noise at the samples, whatever y does between them:
so there is no error of discretisation. Integrators are known: A(s) = s^k A'(s), and only the coefficients of A' are
unknown; with s^i / A = s^(i-k) / A' no signal is integrated but the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.transfer.bounded import respond_bounded
from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.late import delay_states
from pmfid.transfer.propagate import respond
from pmfid.types import Floats


@dataclass(frozen=True)
class Structure:
    """n poles, m zeros, with or without a constant in addition to the input.

    integrators: number of poles at 0. unstable: poles may be in the right half-plane. dead_time: of the input,
    beyond what the stretches know of, in their unit of time; latest: None where it is known, else it is the last
    parameter, sought from dead_time on and up to this.
    """

    n: int
    m: int
    offset: bool = False
    integrators: int = 0
    unstable: bool = False
    dead_time: float = 0.0
    latest: float | None = None

    @property
    def free(self) -> int:
        """How many coefficients of the denominator are unknown."""
        return self.n - self.integrators

    @property
    def linear(self) -> int:
        """Parameters but for an unknown dead time."""
        return self.free + self.m + 1 + self.offset

    @property
    def size(self) -> int:
        return self.linear + (self.latest is not None)

    def split(self, theta: Floats) -> tuple[Floats, Floats, float]:
        """a (free,), b (m + 1,), offset."""
        b = theta[self.free : self.free + self.m + 1]
        return theta[: self.free], b, float(theta[self.linear - 1]) if self.offset else 0.0

    def denominator(self, theta: Floats) -> Floats:
        """(n,) a_0 to a_{n-1}, with the zeros of the integrators."""
        return np.concatenate([np.zeros(self.integrators), theta[: self.free]])

    def lateness(self, theta: Floats) -> float:
        """The dead time, known or unknown."""
        return self.dead_time if self.latest is None else float(theta[-1])

    @property
    def respond(self) -> Callable[..., Floats]:
        """How its states follow a signal."""
        return respond_bounded if self.unstable else respond

    def scale(self, rate: float) -> Floats:
        """(p,) factors from parameters in time units of 1/rate to parameters in seconds."""
        powers = [self.n - i for i in range(self.integrators, self.n)] + [self.n - j for j in range(self.m + 1)]
        powers += [self.n] * self.offset + [-1] * (self.latest is not None)
        return np.asarray(rate ** np.array(powers, float))


@dataclass(frozen=True)
class Linearised:
    """On r measured samples: error (r,) y minus the simulated output; phi (r, p) regressors from the data, zeta (r, p)
    from the simulated output alone, its sensitivities; free (r, n) responses to the initial conditions."""

    error: Floats
    phi: Floats
    zeta: Floats
    free: Floats


@dataclass(frozen=True)
class Channels:
    """Filtered inputs, constant 1 (with offset) and impulse, a channel each. single (n+1, channels, M): s^k / A;
    double (2n-k, channels, M): s^j / (A A'), or none; slopes (channels, M): s^(n+1) / A, from how fast a late input
    changes."""

    single: Floats
    double: Floats
    slopes: Floats

    def moving(self, b: Floats, source: int) -> Floats:
        """(M,) how fast the response B/A to an input changes."""
        further = [*self.single[1:, source], self.slopes[source]]
        return np.asarray(sum(value * further[j] for j, value in enumerate(b)))


def companion(a: Floats) -> Floats:
    """F of the states s^i / A(s) w, i < n."""
    F = np.diag(np.ones(a.size - 1), 1)
    F[-1] = -a
    return F


def channels(structure: Structure, theta: Floats, stretch: RecordStretch, *, twice: bool) -> Channels:
    """At theta (p,), through its denominator and dead time; twice: with s^j / (A A')."""
    n, free, size, late = structure.n, structure.free, stretch.grid.size, structure.lateness(theta)
    a = structure.denominator(theta)
    w = np.vstack([stretch.inputs, np.ones((int(structure.offset), size)), np.zeros((1, size))])
    F = companion(a)
    if twice and free:
        F = np.block([[F, np.zeros((n, free))], [np.zeros((free, n)), companion(theta[:free])]])
        F[-1, 0] = 1.0
    start = np.zeros((F.shape[0], w.shape[0]))
    start[n - 1, -1] = 1.0
    g = np.eye(F.shape[0])[n - 1]
    states, slopes = structure.respond(F, g, stretch.grid, w, start, held=stretch.held), np.zeros(w.shape)
    if late or structure.latest is not None:
        few = slice(0, stretch.inputs.shape[0])
        found = delay_states(F, g, stretch.grid, w[few], states[:, few], late, held=stretch.held)
        states[:, few], w[few], slopes[few] = found.states, found.inputs, found.slopes
    single = np.concatenate([states[:n], (w - np.tensordot(a, states[:n], 1))[None]])
    slopes = slopes - np.tensordot(a, single[1:], 1)
    return Channels(single, _double(theta[:free], single, states[n:]) if twice else single[:0], slopes)


def _double(a: Floats, single: Floats, states: Floats) -> Floats:
    """s^j / (A A') from 0 on, from those with j < free: s^(free+r) / (A A') = s^r / A - sum a_i s^(r+i) / (A A')."""
    double = list(states)
    for r in range(single.shape[0] - 1):
        double.append(single[r] - sum(a[i] * double[r + i] for i in range(a.size)))
    return np.array(double)


def linearise(structure: Structure, theta: Floats, initial: Floats, stretch: RecordStretch) -> Linearised:
    """At theta (p,), with initial conditions (n,) of the stretch; time in the unit of the stretch."""
    n, free = structure.n, structure.free
    a, b, offset = structure.split(theta)
    here = channels(structure, theta, stretch, twice=True)
    single, double = here.single, here.double
    simulated = b @ single[: b.size, 0] + initial @ single[:n, -1]
    if structure.offset:
        simulated = simulated + offset * single[0, -2]
    source = stretch.inputs.shape[0] - 1  # the reference, where there is one
    zeta = [b @ double[i : i + b.size, source] + initial @ double[i : i + n, -1] for i in range(free)]
    if structure.offset:
        zeta = [slope + offset * double[i, -2] for i, slope in enumerate(zeta)]
    constant = single[:1, -2] if structure.offset else single[:0, -2]
    phi_late, zeta_late = ([], []) if structure.latest is None else ([here.moving(b, 0)], [here.moving(b, source)])
    rows = stretch.rows
    return Linearised(
        (stretch.y - simulated)[rows],
        _stack_columns(
            [
                *(-_filter_output(structure, a, stretch)),
                *single[: b.size, 0],
                *constant,
                *(-moving for moving in phi_late),
            ],
            rows,
        ),
        _stack_columns(
            [*(-slope for slope in zeta), *single[: b.size, source], *constant, *(-moving for moving in zeta_late)],
            rows,
        ),
        single[:n, -1][:, rows].T,
    )


def _filter_output(structure: Structure, a: Floats, stretch: RecordStretch) -> Floats:
    """(free, M) s^i / A' of the output."""
    if not a.size:
        return np.zeros((0, stretch.grid.size))
    start = np.zeros((a.size, 1))
    return structure.respond(companion(a), np.eye(a.size)[-1], stretch.grid, stretch.y[None], start, held=False)[:, 0]


def _stack_columns(columns: list[Floats], rows: NDArray[np.int64]) -> Floats:
    return np.array(columns)[:, rows].T


def simulate(
    structure: Structure, theta: Floats, initial: Floats, stretch: RecordStretch, *, source: int | None = None
) -> Floats:
    """Output (M,) from the initial conditions (n,) and an input alone: `source` of the stretch's, None: what
    instruments are made from."""
    _, b, offset = structure.split(theta)
    single = channels(structure, theta, stretch, twice=False).single
    source = stretch.inputs.shape[0] - 1 if source is None else source
    constant = offset * single[0, -2] if structure.offset else 0.0
    return np.asarray(b @ single[: b.size, source] + initial @ single[: structure.n, -1] + constant)


def stable(a: Floats, duration: float) -> Floats:
    """a with poles in the right half-plane reflected; those that hardly grow within the duration may stay."""
    poles = np.roots(np.r_[1.0, a[::-1]])
    bad = poles.real * duration > 1.0
    if not np.any(bad):
        return a
    mirrored = np.where(bad, -poles.real, poles.real) + 1j * poles.imag
    return np.asarray(np.poly(mirrored).real[:0:-1])
