"""A record behind the filters: the input as a sum of acceleration, velocity, direction and a constant load.

One run of the kernel gives the columns; what follows from other inputs, shifted ones above all, is a projection. The
pole is that behind which most of the input is explained: a coarse encoder asks for a slow one.
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

#: Time constants of the filters to look through [samples].
TIMES = (3.0, 10.0, 30.0, 100.0)
#: Pieces of the record whose differences tell how well a number is known; samples that a piece must have.
PARTS, SHORTEST = 8, 20
#: Time constants that a record must have: behind slow filters a short one is explained by anything.
ENOUGH = 60.0
#: Part of the travel that goes back, of a motion in both directions.
ONE_WAY = 0.05
#: Speed over which friction at rest falls, in parts of the usual speed.
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
        """(n, r): orthonormal columns that span those of phi; a column that is zero is left out."""
        size = np.linalg.norm(self.phi, axis=0)
        return np.asarray(np.linalg.qr(self.phi[:, size > 0] / size[size > 0])[0])

    @cached_property
    def unexplained(self) -> float:
        """Part of the input that no such sum explains."""
        return float(self.measure_rest(self.z))

    def measure_rest(self, z: Floats) -> float:
        """The same for another filtered input (n,)."""
        size = float(np.linalg.norm(z))
        return float(np.linalg.norm(z - self.basis @ (self.basis.T @ z))) / size if size > 0 else 1.0

    @cached_property
    def theta(self) -> Floats:
        """(p,): mass, viscous and Coulomb friction, load, further terms, per unit of the input; 0 if not visible."""
        return solve_least_squares(self.phi, self.z)

    @cached_property
    def pieces(self) -> Floats:
        """(PARTS, p): theta of the record without one piece each."""
        edges = np.linspace(0, self.z.size, PARTS + 1).astype(int)
        rows = np.arange(self.z.size)
        kept = [(rows < a) | (rows >= b) for a, b in pairwise(edges)]
        return np.array([solve_least_squares(self.phi[keep], self.z[keep]) for keep in kept])

    def sure(self, weights: Floats) -> float:
        """A sum of the theta (p,) with weights (p,), in its standard deviations (jackknife over the pieces)."""
        value, others = float(self.theta @ weights), self.pieces @ weights
        spread = float(np.sqrt((PARTS - 1) / PARTS * np.sum((others - others.mean()) ** 2)))
        return value / spread if spread > 0 else float(np.sign(value)) * np.inf

    @property
    def one_way(self) -> bool:
        """Does it move in one direction, nearly all the time? Dry friction is then a load."""
        velocity = self.phi[:, VISCOUS]
        back = float(np.sum(np.abs(velocity[velocity < 0]))) / max(float(np.sum(np.abs(velocity))), 1e-300)
        return min(back, 1 - back) < ONE_WAY

    @property
    def moving(self) -> float:
        """Rows over which the motion is spread, for so many equal ones would have its power and the square of that."""
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
    """The view in which most of the input is explained, of those whose motion lasts for more than so many time
    constants; None where the record is too short, or nothing moves."""
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
