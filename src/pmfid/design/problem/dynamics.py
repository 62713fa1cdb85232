"""The axis as a linear system for each direction of motion, with the derivatives of its matrices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from pmfid.models.drive import Drive
from pmfid.types import Floats

__all__ = ["Regime", "StateStep", "discretise", "drive_regime"]

#: State of a drive.
POSITION, VELOCITY = 0, 1


@dataclass(frozen=True, eq=False)
class Regime:
    """x' = A x + b u + g, y = c x while the plant stays in it, and how that depends on p parameters.

    A: (n, n); b, g, c: (n,); A_slope: (p, n, n); b_slope, g_slope: (p, n): derivatives to the parameters; c depends
    on none. entry: (n, n), what the sensitivities of the state are multiplied with where the regime begins: the
    identity, but for a rest, in which friction takes out every deviation of velocity.
    """

    A: Floats
    b: Floats
    g: Floats
    c: Floats
    A_slope: Floats
    b_slope: Floats
    g_slope: Floats
    entry: Floats


@dataclass(frozen=True, eq=False)
class StateStep:
    """One step of the state and its sensitivities, X = (x, dx/dp_1, ..., dx/dp_p): X+ = A X + b u + g.

    A: (n(p+1), n(p+1)); b, g: (n(p+1),). Exact for an input that is held.
    """

    A: Floats
    b: Floats
    g: Floats


def drive_regime(drive: Drive, nominal: Mapping[str, float], names: tuple[str, ...], direction: int) -> Regime:
    """m v' = input_gain u - d v - direction F_c - offset, or rest where the direction is 0; state (position, velocity).

    names: the p parameters for which derivatives are wanted.
    """
    if direction == 0:
        return _rest(len(names))
    side = {1: "_forward", -1: "_backward"}[direction]
    viscous, coulomb = (_present(nominal, name, side) for name in ("viscous_friction", "coulomb_friction"))
    mass = nominal["mass"]
    # force on the mass per unit of (position, velocity, input, 1)
    force = np.array([0.0, -nominal[viscous], drive.equation.input_gain, -direction * nominal[coulomb]])
    force[3] -= nominal.get("offset", 0.0)
    slopes = {
        "mass": -force / mass**2,
        viscous: np.array([0.0, -1.0, 0.0, 0.0]) / mass,
        coulomb: np.array([0.0, 0.0, 0.0, -direction]) / mass,
        "offset": np.array([0.0, 0.0, 0.0, -1.0]) / mass,
    }
    slope = np.zeros((len(names), 2, 4))
    for i, name in enumerate(names):
        slope[i, VELOCITY] = slopes.get(name, 0.0)
    field = np.array([[0.0, 1.0, 0.0, 0.0], force / mass])
    split = (field[:, :2], field[:, 2], field[:, 3])
    return Regime(*split, np.array([1.0, 0.0]), slope[:, :, :2], slope[:, :, 2], slope[:, :, 3], np.eye(2))


def _present(nominal: Mapping[str, float], name: str, side: str) -> str:
    return name if name in nominal else name + side


def _rest(size: int) -> Regime:
    none, many = np.zeros(2), np.zeros((size, 2))
    hold = np.diag([1.0, 0.0])
    return Regime(np.zeros((2, 2)), none, none, np.array([1.0, 0.0]), np.zeros((size, 2, 2)), many, many, hold)


def discretise(regime: Regime, dt: float) -> StateStep:
    """The step over dt [s] of the state and its sensitivities, by one matrix exponential (Van Loan 1978)."""
    p, n = regime.b_slope.shape
    size = n * (p + 1)
    M = np.zeros((size + 2, size + 2))
    for i in range(p + 1):
        rows = slice(n * i, n * (i + 1))
        M[rows, rows] = regime.A
        M[rows, size] = regime.b_slope[i - 1] if i else regime.b
        M[rows, size + 1] = regime.g_slope[i - 1] if i else regime.g
        if i:
            M[rows, :n] = regime.A_slope[i - 1]
    E = expm(M * dt)
    return StateStep(E[:size, :size], E[:size, size], E[:size, size + 1])
