"""Linear processes under a held input, solved exactly by the matrix exponential, and the plants of the studies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation.encoder import check_number
from pmfid.simulation.signals import mls
from pmfid.types import Floats


@dataclass(frozen=True)
class SimulatedProcess:
    """A process b_m s^m + ... + b_0 over s^n + a_{n-1} s^{n-1} + ... + a_0, and its excitation.

    `b` and `a` have descending powers; `a` includes its leading 1. `dt` is the sample period [s]. `stages` and `clock`
    belong to a maximum length sequence of +-1 with `samples` values. `cutoff` and `zeros` [rad/s] belong to the filters
    and the pre-filter of the studies.
    """

    name: str
    b: tuple[float, ...]
    a: tuple[float, ...]
    dt: float
    clock: int
    samples: int
    cutoff: float
    zeros: tuple[float, ...]
    stages: int = 10

    @property
    def theta(self) -> Floats:
        """Parameters a0 to a{n-1}, b0 to bm (n + m + 1,)."""
        return np.array([*self.a[:0:-1], *self.b[::-1]])

    @property
    def u(self) -> Floats:
        """Input (samples,)."""
        return np.resize(mls(self.stages, self.clock, 1.0), self.samples)

    @property
    def y(self) -> Floats:
        """Output (samples,) without noise, from rest."""
        return simulate_process(self.b, self.a, self.u, self.dt)


#: Plants of the black-box study. The last plant comes from Rao and Garnier (2002).
PLANTS = {
    plant.name: plant
    for plant in (
        SimulatedProcess("second-order", (3.0,), (1.0, 4.0, 3.0), 0.05, 3, 3069, 5.0, (-1.0, -3.0)),
        SimulatedProcess("non-minimum-phase", (1.0, -1.0), (1.0, 2.0, 1.0), 0.1, 4, 5000, 2.0, (-0.5, -1.5)),
        SimulatedProcess(
            "rao-garnier",
            (-6400.0, 1600.0),
            (1.0, 5.0, 408.0, 416.0, 1600.0),
            0.01,
            7,
            7161,
            20.0,
            (-1.0, -2.0, -4.0, -8.0),
        ),
    )
}


def simulate_process(
    b: ArrayLike, a: ArrayLike, u: ArrayLike, steps: float | ArrayLike, *, hold: str = "zoh"
) -> Floats:
    """Simulate the output (n,) of a process from rest, at the instants of the input u (n,).

    `b` and `a` are numerator and denominator in descending powers of s, strictly proper. `steps` is the sample period
    [s], or the times (n-1,) between the instants. `hold` is "zoh" or "foh". Raises ValueError for a step that is not
    positive.
    """
    from scipy.linalg import expm

    u = np.asarray(u, float)
    times = np.broadcast_to(np.asarray(steps, float), (u.size - 1,))
    for value in np.unique(times):
        check_number("steps", float(value), above=0.0, remedy="give the sample period in seconds")
    A, B, C = make_state_space(np.atleast_1d(np.asarray(b, float)), np.asarray(a, float))
    n = A.shape[0]
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = A, B, 1.0
    moves = {value: expm(block * np.array([value] * n + [1.0, 1.0])[:, None]) for value in np.unique(times)}
    x, y = np.zeros(n), np.zeros(u.size)
    for k, step in enumerate(times):
        move = moves[step]
        x = move[:n, :n] @ x + move[:n, n] * u[k]
        if hold == "foh":
            x = x + move[:n, n + 1] * (u[k + 1] - u[k])
        y[k + 1] = C @ x
    return y


def make_state_space(b: Floats, a: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the controllable form, with time in units that give the coefficients similar sizes."""
    n = a.size - 1
    rate = float(np.max(np.abs(np.roots(a)), initial=0.0)) or 1.0
    scaled = a[1:] / a[0] / rate ** np.arange(1, n + 1)
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -scaled[::-1]
    C = np.zeros(n)
    C[: b.size] = b[::-1] / a[0] / rate ** np.arange(n, n - b.size, -1)
    return A * rate, np.eye(n)[-1] * rate, C
