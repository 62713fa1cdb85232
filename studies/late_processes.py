"""Linear processes with a late input or under control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from pmfid.simulation.process import make_state_space, simulate_process
from pmfid.types import Floats


def simulate_late(
    b: ArrayLike, a: ArrayLike, u: ArrayLike, dt: float, dead_time: float, *, hold: str = "zoh"
) -> Floats:
    """Return the output (n,) from rest under the input u (n,) of `dead_time` [s] ago, which is 0 before the record.

    b and a are as in `simulate_process`, but the numerator may have the order of the denominator. Separate steps lead
    from each sample to the switch of the late input and on to the next sample.
    """
    u, b, a = np.asarray(u, float), np.atleast_1d(np.asarray(b, float)), np.asarray(a, float)
    whole = int(np.floor(dead_time / dt + 1e-9))
    rest = max(0.0, dead_time - whole * dt)
    late = np.r_[np.zeros(whole), u][: u.size]
    through = b[0] / a[0] if b.size == a.size else 0.0
    strict = (b - through * a)[1:] if b.size == a.size else b
    if rest <= 1e-9 * dt:
        return np.asarray(simulate_process(strict, a, late, dt, hold=hold) + through * late)
    before = np.r_[0.0, late[:-1]]
    between = before if hold == "zoh" else before + (late - before) * (1 - rest / dt)
    both = np.column_stack([between, late]).ravel()  # at each sample, and at each switch of the late input
    at_samples = simulate_process(strict, a, both, np.resize([rest, dt - rest], both.size - 1), hold=hold)[::2]
    return np.asarray(at_samples + through * between)


@dataclass(frozen=True)
class Controller:
    """A controller u = gain (1 + lead s / (lag s + 1)) (reference - y), by backward differences; lead, lag [s]."""

    gain: float
    lead: float = 0.0
    lag: float = 0.0


def simulate_loop(
    b: ArrayLike, a: ArrayLike, controller: Controller, reference: ArrayLike, noise: ArrayLike, dt: float
) -> tuple[Floats, Floats]:
    """Return u, y (n,) of a strictly proper process from rest under a controller that reads y with its noise (n,)."""
    r, v = np.asarray(reference, float), np.asarray(noise, float)
    A, B, C = make_state_space(np.atleast_1d(np.asarray(b, float)), np.asarray(a, float))
    n = A.shape[0]
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, B
    move = expm(block * dt)
    x, slope, before, u, y = np.zeros(n), 0.0, 0.0, np.zeros(r.size), np.zeros(r.size)
    for k in range(r.size):
        y[k] = C @ x + v[k]
        error = r[k] - y[k]
        slope = (controller.lag * slope + error - before) / (controller.lag + dt)
        before = error
        u[k] = controller.gain * (error + controller.lead * slope)
        x = move[:n, :n] @ x + move[:n, n] * u[k]
    return u, y
