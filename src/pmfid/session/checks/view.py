"""The filtered record: the input as a sum of acceleration, velocity, direction and a constant load.

One run of the kernel gives the columns; the unexplained part of other inputs, such as shifted ones, is a projection.
The chosen filter explains most of the input: a coarse encoder needs a slow filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.ls import LS
from pmfid.models.drive import Drive
from pmfid.types import Counts, Floats

__all__ = ["PARTS", "View", "best_view", "view", "with_friction"]

#: Time constants of the filters that are tried [samples].
TIMES = (3.0, 10.0, 30.0, 100.0)
#: Pieces of the record, whose differences give standard deviations; least samples of a piece.
PARTS, SHORTEST = 8, 20
#: Least duration of a record, in time constants: after slow filtering anything explains a short record.
ENOUGH = 60.0
#: Least part of the travel that goes back in a motion with both directions.
ONE_WAY = 0.05
#: Speed over which friction at rest falls, as a part of the usual speed.
SLOW = 0.1
MASS, VISCOUS, COULOMB, LOAD = range(4)
#: The model of these four columns.
PLAIN = Drive(1.0, offset=True)


@dataclass(frozen=True, eq=False)
class View:
    """Columns phi (n, p) of motion, the first those of the plain drive, and the filtered input z (n,), after filters
    with a time constant of `time` samples."""

    time: float
    phi: Floats
    z: Floats

    @cached_property
    def basis(self) -> Floats:
        """(n, r): an orthonormal basis of the columns of phi; columns that are zero are left out."""
        size = np.linalg.norm(self.phi, axis=0)
        return np.asarray(np.linalg.qr(self.phi[:, size > 0] / size[size > 0])[0])

    @cached_property
    def unexplained(self) -> float:
        """Part of the input that no sum of the columns explains."""
        return float(self.measure_rest(self.z))

    def measure_rest(self, z: Floats) -> float:
        """Part of another filtered input (n,) that no sum of the columns explains."""
        size = float(np.linalg.norm(z))
        return float(np.linalg.norm(z - self.basis @ (self.basis.T @ z))) / size if size > 0 else 1.0

    @cached_property
    def theta(self) -> Floats:
        """(p,): mass, viscous and Coulomb friction, load, further terms, per unit of the input; 0 if not visible."""
        return solve_least_squares(self.phi, self.z)

    @cached_property
    def pieces(self) -> Floats:
        """(PARTS, p): theta of the record, each time without one piece."""
        edges = np.linspace(0, self.z.size, PARTS + 1).astype(int)
        rows = np.arange(self.z.size)
        kept = [(rows < a) | (rows >= b) for a, b in pairwise(edges)]
        return np.array([solve_least_squares(self.phi[keep], self.z[keep]) for keep in kept])

    def sure(self, weights: Floats) -> float:
        """The sum of theta (p,) with weights (p,), in its standard deviations (jackknife over the pieces)."""
        value, others = float(self.theta @ weights), self.pieces @ weights
        spread = float(np.sqrt((PARTS - 1) / PARTS * np.sum((others - others.mean()) ** 2)))
        return value / spread if spread > 0 else float(np.sign(value)) * np.inf

    @property
    def one_way(self) -> bool:
        """Does the axis move in one direction nearly all the time? Dry friction is then a load."""
        velocity = self.phi[:, VISCOUS]
        back = float(np.sum(np.abs(velocity[velocity < 0]))) / max(float(np.sum(np.abs(velocity))), 1e-300)
        return min(back, 1 - back) < ONE_WAY

    @property
    def moving(self) -> float:
        """Effective number of moving rows: rows of equal power that have the same first two moments of power."""
        power = np.square(self.phi[:, VISCOUS])
        return float(power.sum() ** 2 / max(float(np.sum(power**2)), 1e-300))

    @property
    def friction_work(self) -> Floats:
        """Weights (p,) of the power that friction takes from the motion."""
        velocity, weights = self.phi[:, VISCOUS], np.zeros(self.theta.size)
        weights[VISCOUS], weights[COULOMB] = np.mean(velocity**2), np.mean(self.phi[:, COULOMB] * velocity)
        return weights


def solve_least_squares(phi: Floats, z: Floats) -> Floats:
    """(p,): least squares of z (n,) on phi (n, p)."""
    size = np.linalg.norm(phi, axis=0)
    scale = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(phi / scale, z, rcond=1e-10)[0] / scale)


def view(u: Floats, counts: Counts, encoder: Encoder, dt: float, time: float, model: Drive = PLAIN) -> View | None:
    """The record after filters of a time constant [samples], with the columns of a model with input gain 1; None if the
    filters do not settle within the record."""
    method = LS(model, replace(encoder, guard=False), dt, 1 / (time * dt))
    if u.size < max(method.settle_samples + PARTS * SHORTEST, ENOUGH * time):
        return None
    columns = method.columns(u, counts)
    return View(time, columns.phi, columns.z)


def best_view(
    u: Floats, counts: Counts, encoder: Encoder, dt: float, lasting: float = 0.0, model: Drive = PLAIN
) -> View | None:
    """The view that explains most of the input, among views whose motion lasts for more than `lasting` time constants;
    None if the record is too short, or nothing moves."""
    views = [view(u, counts, encoder, dt, time, model) for time in TIMES]
    moved = [one for one in views if one is not None and np.any(one.z) and np.any(one.phi[:, VISCOUS])]
    seen = [one for one in moved if one.moving > lasting * one.time]
    return min(seen, key=lambda one: one.unexplained) if seen else None


def with_friction(view: View) -> Floats:
    """(n, 7): the columns of a view, and friction that falls with speed, grows with its square, or differs by
    direction."""
    velocity, direction = view.phi[:, VISCOUS], view.phi[:, COULOMB]
    usual = float(np.sqrt(np.mean(velocity**2))) or 1.0
    slow = direction * np.exp(-((velocity / (SLOW * usual)) ** 2))
    return np.column_stack([view.phi, slow, velocity * np.abs(velocity), np.abs(direction)])
