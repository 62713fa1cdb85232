"""Responses of a transfer function at the samples, and their sensitivities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.linear.experiment import Grid, RecordStretch, respond, transition
from pmfid.linear.tuning import TUNING
from pmfid.types import Floats


def respond_bounded(F: Floats, g: Floats, grid: Grid, w: Floats, start: Floats, *, held: bool) -> Floats:
    """Return the states as `respond` does, but simulate fast unstable modes in reversed time.

    Fast unstable modes grow by more than the factor e over the grid. The part of `start` for fast unstable modes
    belongs to the last instant.
    """
    from scipy.linalg import schur, solve_sylvester  # slow to import

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
    return np.asarray(np.einsum("ij,jck->ick", Q @ apart, modes))


def _reverse_time(w: Floats, held: bool) -> Floats:
    """Return the inputs (channels, N) in reversed time, in which a held value belongs to the step before."""
    return np.concatenate([w[:, -2::-1], w[:, :1]], axis=1) if held else w[:, ::-1]


@dataclass(frozen=True)
class Late:
    """Late states (n, channels, N), late inputs (channels, N) and the slopes of the inputs.

    Each value belongs to the time one dead time before its instant. Values before the first instant are zero.
    """

    states: Floats
    inputs: Floats
    slopes: Floats


def delay_states(F: Floats, g: Floats, grid: Grid, w: Floats, states: Floats, dead_time: float, *, held: bool) -> Late:
    """Return late states and inputs, from states (n, channels, N) of x' = F x + g w and w (channels, N) on the grid.

    The input w is held or linear. Each reading starts at the preceding instant, so that a switch of the input within a
    sample has its exact effect.
    """
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
    """Return the last instant (N,) at or before each reading, and the time from that instant to the reading.

    The number of the instant is negative if no such instant exists.
    """
    if isinstance(grid.steps, float):
        whole = int(np.ceil(dead_time / grid.steps - TUNING.experiment_same))
        rest = max(0.0, whole * grid.steps - dead_time)
        return np.arange(grid.size) - whole, np.full(
            grid.size, rest if rest > TUNING.experiment_same * grid.steps else 0.0
        )
    wanted, close = t - dead_time, TUNING.experiment_same * float(np.median(steps))
    index = np.searchsorted(t, wanted + close, side="right") - 1
    return index, np.maximum(0.0, wanted - t[np.maximum(index, 0)]) * (index >= 0)


def _advance_states(F: Floats, g: Floats, grid: Grid, x: Floats, w: Floats, slope: Floats, rest: Floats) -> Floats:
    """Return the states x (n, channels, N) after the further times `rest` (N,)."""
    if grid.uniform:
        step = transition(F, g, Grid(float(rest[0]), 2))
        moved = np.einsum("ij,jck->ick", step.phi, x)
        return np.asarray(moved + step.now[:, None, None] * w + step.change[:, None, None] * slope * rest)
    step = transition(F, g, Grid(rest, rest.size + 1))
    moved = np.einsum("kij,jck->ick", step.phi, x)
    return np.asarray(moved + step.now.T[:, None] * w + step.change.T[:, None] * slope * rest)


@dataclass(frozen=True)
class Structure:
    """A transfer function with n poles and m zeros, with or without a constant output.

    `integrators` is the number of poles at 0. If `unstable`, poles may lie in the right half-plane. `dead_time` is the
    dead time of the input that the stretches do not contain, in their unit of time. `latest` is None for a known dead
    time. An unknown dead time is the last parameter, between dead_time and `latest`.
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
        """The number of unknown coefficients of the denominator."""
        return self.n - self.integrators

    @property
    def linear(self) -> int:
        """The number of parameters without an unknown dead time."""
        return self.free + self.m + 1 + self.offset

    @property
    def size(self) -> int:
        return self.linear + (self.latest is not None)

    def split(self, theta: Floats) -> tuple[Floats, Floats, float]:
        """Return a (free,), b (m + 1,) and the offset."""
        b = theta[self.free : self.free + self.m + 1]
        return theta[: self.free], b, float(theta[self.linear - 1]) if self.offset else 0.0

    def denominator(self, theta: Floats) -> Floats:
        """Return the coefficients (n,) a_0 to a_{n-1}, with the zeros of the integrators."""
        return np.concatenate([np.zeros(self.integrators), theta[: self.free]])

    def lateness(self, theta: Floats) -> float:
        """Return the dead time, whether it is known or a parameter."""
        return self.dead_time if self.latest is None else float(theta[-1])

    @property
    def respond(self) -> Callable[..., Floats]:
        """The function that simulates the states for a signal."""
        return respond_bounded if self.unstable else respond

    def scale(self, rate: float) -> Floats:
        """Return the factors (p,) from parameters in time units of 1/rate to parameters in seconds."""
        powers = [self.n - i for i in range(self.integrators, self.n)] + [self.n - j for j in range(self.m + 1)]
        powers += [self.n] * self.offset + [-1] * (self.latest is not None)
        return np.asarray(rate ** np.array(powers, float))


@dataclass(frozen=True)
class Linearised:
    """The linearised problem at r measured samples.

    `error` (r,) is y minus the simulated output. `phi` (r, p) are regressors from the data. `zeta` (r, p) are
    sensitivities from the simulated output alone. `free` (r, n) are responses to the initial conditions.
    """

    error: Floats
    phi: Floats
    zeta: Floats
    free: Floats


@dataclass(frozen=True)
class Channels:
    """Filtered signals, one channel each: the inputs, the constant 1 (with an offset) and an impulse.

    `single` (n+1, channels, M) holds s^k / A. `double` (2n-k, channels, M) holds s^j / (A A'), or is empty. `slopes`
    (channels, M) holds s^(n+1) / A from the slope of a late input.
    """

    single: Floats
    double: Floats
    slopes: Floats

    def moving(self, b: Floats, source: int) -> Floats:
        """Return the slope (M,) of the response B/A to an input."""
        further = [*self.single[1:, source], self.slopes[source]]
        return np.asarray(sum(value * further[j] for j, value in enumerate(b)))


def companion(a: Floats) -> Floats:
    """Return the matrix F of the states s^i / A(s) w with i < n."""
    F = np.diag(np.ones(a.size - 1), 1)
    F[-1] = -a
    return F


def channels(structure: Structure, theta: Floats, stretch: RecordStretch, *, twice: bool) -> Channels:
    """Return the channels for the denominator and the dead time in theta (p,), with s^j / (A A') if `twice`."""
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
    """Return s^j / (A A') for all j from 0, given those with j < free.

    The recursion is s^(free+r) / (A A') = s^r / A - sum a_i s^(r+i) / (A A').
    """
    double = list(states)
    for r in range(single.shape[0] - 1):
        double.append(single[r] - sum(a[i] * double[r + i] for i in range(a.size)))
    return np.array(double)


def linearise(structure: Structure, theta: Floats, initial: Floats, stretch: RecordStretch) -> Linearised:
    """Return the linearisation at theta (p,) and initial conditions (n,), with time in the unit of the stretch."""
    n, free = structure.n, structure.free
    a, b, offset = structure.split(theta)
    here = channels(structure, theta, stretch, twice=True)
    single, double = here.single, here.double
    simulated = b @ single[: b.size, 0] + initial @ single[:n, -1]
    if structure.offset:
        simulated = simulated + offset * single[0, -2]
    source = stretch.inputs.shape[0] - 1  # with a reference, the last input is the part that the reference explains
    zeta = [b @ double[i : i + b.size, source] + initial @ double[i : i + n, -1] for i in range(free)]
    if structure.offset:
        zeta = [slope + offset * double[i, -2] for i, slope in enumerate(zeta)]
    constant = single[:1, -2] if structure.offset else single[:0, -2]
    phi_late, zeta_late = ([], []) if structure.latest is None else ([here.moving(b, 0)], [here.moving(b, source)])
    outputs = _filter_output(structure, a, stretch)
    phi = [*(-outputs), *single[: b.size, 0], *constant, *(-moving for moving in phi_late)]
    slopes = [*(-slope for slope in zeta), *single[: b.size, source], *constant, *(-moving for moving in zeta_late)]
    regressors, sensitivities = (np.array(columns)[:, stretch.rows].T for columns in (phi, slopes))
    error = (stretch.y - simulated)[stretch.rows]
    return Linearised(error, regressors, sensitivities, single[:n, -1][:, stretch.rows].T)


def _filter_output(structure: Structure, a: Floats, stretch: RecordStretch) -> Floats:
    """Return s^i / A' of the output (free, M)."""
    if not a.size:
        return np.zeros((0, stretch.grid.size))
    start = np.zeros((a.size, 1))
    return structure.respond(companion(a), np.eye(a.size)[-1], stretch.grid, stretch.y[None], start, held=False)[:, 0]


def simulate(structure: Structure, theta: Floats, initial: Floats, stretch: RecordStretch) -> Floats:
    """Return the output (M,) from the initial conditions (n,) and the measured input."""
    _, b, offset = structure.split(theta)
    single = channels(structure, theta, stretch, twice=False).single
    constant = offset * single[0, -2] if structure.offset else 0.0
    return np.asarray(b @ single[: b.size, 0] + initial @ single[: structure.n, -1] + constant)


def stable(a: Floats, duration: float) -> Floats:
    """Return the coefficients a after a reflection of poles from the right half-plane, except those of a response that
    hardly grows within the duration."""
    poles = np.roots(np.r_[1.0, a[::-1]])
    bad = poles.real * duration > 1.0
    if not np.any(bad):
        return a
    mirrored = np.where(bad, -poles.real, poles.real) + 1j * poles.imag
    return np.asarray(np.poly(mirrored).real[:0:-1])
