"""Responses of a transfer function at the samples, and their sensitivities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import schur, solve_sylvester

from pmfid._stage import first_order
from pmfid.linear.experiment import Grid, RecordStretch, product, respond, transition
from pmfid.linear.tuning import TUNING
from pmfid.types import Floats


def respond_bounded(F: Floats, g: Floats, grid: Grid, w: Floats, start: Floats, *, held: bool) -> Floats:
    """As `respond`, but modes that grow by more than e over the grid run backward, and have their part of `start` at
    the last instant."""
    n, limit = F.shape[0], 1 / max(grid.duration, 1e-300)
    T, Q, kept = schur(F - limit * np.eye(n), sort="lhp")
    if kept == n:
        return respond(F, g, grid, w, start, held=held)
    T = T + limit * np.eye(n)
    X = solve_sylvester(T[:kept, :kept], -T[kept:, kept:], -T[:kept, kept:]) if kept else np.zeros((0, n))
    apart, back = np.eye(n), np.eye(n)
    apart[:kept, kept:], back[:kept, kept:] = X, -X
    g, start = back @ Q.T @ g, back @ Q.T @ start
    parts = []
    if kept:
        parts.append(respond(T[:kept, :kept], g[:kept], grid, w, start[:kept], held=held))
    late = respond(-T[kept:, kept:], -g[kept:], grid.reversed, _reverse_time(w, held), start[kept:], held=held)
    modes = np.concatenate([*parts, late[..., ::-1]])
    return product(Q @ apart, modes.reshape(n, -1)).reshape(modes.shape)


def _reverse_time(w: Floats, held: bool) -> Floats:
    """w (channels, N) for time that runs backward: a held value belongs to the step before it then."""
    return np.concatenate([w[:, -2::-1], w[:, :1]], axis=1) if held else w[:, ::-1]


@dataclass(frozen=True)
class Late:
    """states (n, channels, N), inputs (channels, N), their slopes, the dead time before each instant; zero where that
    is before the first one."""

    states: Floats
    inputs: Floats
    slopes: Floats


def delay_states(F: Floats, g: Floats, grid: Grid, w: Floats, states: Floats, dead_time: float, *, held: bool) -> Late:
    """From states (n, channels, N) of x' = F x + g w at the instants of the grid and w (channels, N), held or linear.

    Each reading starts at the last instant before it, so a switch of the input inside a sample has its exact effect."""
    t = grid.instants
    steps = np.broadcast_to(np.asarray(grid.steps, float), (grid.size - 1,))
    index, rest = _places(grid, t, steps, dead_time)
    known = index >= 0
    index = np.maximum(index, 0)
    ahead = np.minimum(index, grid.size - 2)
    slope = np.zeros(w[:, index].shape) if held else (np.diff(w) / steps)[:, ahead]
    found, inputs = states[..., index], w[:, index] + slope * rest
    if np.any(rest):
        found = _advance_states(F, g, grid, found, w[:, index], slope, rest)
    return Late(found * known, inputs * known, slope * known)


def _places(grid: Grid, t: Floats, steps: Floats, dead_time: float) -> tuple[NDArray[np.int64], Floats]:
    """(N,) the last instant at or before each reading, negative where there is none, and the time from there to it."""
    if isinstance(grid.steps, float):
        whole = int(np.ceil(dead_time / grid.steps - TUNING.responses_same))
        rest = max(0.0, whole * grid.steps - dead_time)
        return np.arange(grid.size) - whole, np.full(
            grid.size, rest if rest > TUNING.responses_same * grid.steps else 0.0
        )
    wanted, close = t - dead_time, TUNING.responses_same * float(np.median(steps))
    index = np.searchsorted(t, wanted + close, side="right") - 1
    return index, np.maximum(0.0, wanted - t[np.maximum(index, 0)]) * (index >= 0)


def _advance_states(F: Floats, g: Floats, grid: Grid, x: Floats, w: Floats, slope: Floats, rest: Floats) -> Floats:
    """The states x (n, channels, N) after the further times `rest` (N,)."""
    if grid.uniform:
        step = transition(F, g, Grid(float(rest[0]), 2))
        moved = product(step.phi, x.reshape(F.shape[0], -1)).reshape(x.shape)
        return np.asarray(moved + step.now[:, None, None] * w + step.change[:, None, None] * slope * rest)
    step = transition(F, g, Grid(rest, rest.size + 1))
    moved = np.einsum("kij,jck->ick", step.phi, x)
    return np.asarray(moved + step.now.T[:, None] * w + step.change.T[:, None] * slope * rest)


@dataclass(frozen=True)
class Structure:
    """n poles, m zeros, with or without a constant in addition to the input.

    integrators: number of poles at 0. unstable: poles may be in the right half-plane. dead_time: of the input,
    beyond what the stretches know of, in their unit of time; latest: None if it is known, else it is the last
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
    """The channels at theta (p,), through its denominator and dead time; twice: with s^j / (A A')."""
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
    """The linearisation at theta (p,), with initial conditions (n,) of the stretch; time in the unit of the stretch."""
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


@dataclass(frozen=True)
class Filter:
    """F = (cutoff / (s + cutoff))^order by the trapezoidal rule with the period dt [s]."""

    cutoff: float
    order: int
    dt: float

    def output(self, signal: Floats, k: int) -> Floats:
        """F_T s_T^k of a sampled signal (N,), from rest; k <= order."""
        for stage in range(self.order):
            signal = self.stage(signal, self.cutoff, differentiating=stage < k)
        return signal

    def stage(self, signal: Floats, cutoff: float, *, differentiating: bool) -> Floats:
        """cutoff / (s + cutoff), or s times it."""
        high = 2 / self.dt
        gain, pole = cutoff / (high + cutoff), (high - cutoff) / (high + cutoff)
        top = (gain * high, -gain * high) if differentiating else (gain, gain)
        return first_order(signal, pole, *top)[0]

    def equation(self, signal: Floats, A: Floats) -> Floats:
        """F_T A(s_T) of a sampled signal (N,); A: (n+1,) from the constant on."""
        return np.asarray(sum(A[k] * self.output(signal, k) for k in range(A.size)))


@dataclass(frozen=True)
class ExactTerm:
    """coefficient of s^power times held signal `source`; column: of the unknown, None for a known one."""

    source: int
    power: int
    coefficient: float
    column: int | None


@dataclass(frozen=True)
class Responses:
    """responses (terms, N): s^j / A of each held term's signal, without its coefficient; simulated (N,) output;
    slopes (n+1, N): s^k / A of the simulated output."""

    responses: Floats
    simulated: Floats
    slopes: Floats


def respond_exactly(A: Floats, terms: list[ExactTerm], signals: Floats, dt: float) -> Responses:
    """From rest; A: (n+1,) from the constant on, signals (s, N) held. Powers are less than n."""
    n, size = A.size - 1, signals.shape[1]
    poles = np.roots(A[::-1])
    rate = max(float(np.max(np.abs(poles))), 1e-3 / dt)
    a = A[:-1] / A[-1] / rate ** (n - np.arange(n))
    rows = np.arange(size)
    stretch = RecordStretch(Grid(rate * dt, size), signals, np.zeros(size), rows, rows, held=True)
    found = channels(Structure(n, 0), np.r_[a, 0.0], stretch, twice=True)
    single, double = found.single, found.double

    def size_of(power: int, divisions: int) -> float:
        return float(rate ** (power - divisions * n) / A[-1] ** divisions)

    responses = np.array([single[term.power, term.source] * size_of(term.power, 1) for term in terms])
    weights = np.array([term.coefficient for term in terms])
    slopes = [
        sum(term.coefficient * double[term.power + k, term.source] * size_of(term.power + k, 2) for term in terms)
        for k in range(n + 1)
    ]
    return Responses(responses, weights @ responses, np.array(slopes))
