"""The basis of a free friction curve: filtered hat functions of the speed along the simulated motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import filter_force
from pmfid.estimators.configuration import like
from pmfid.estimators.iv import IV
from pmfid.estimators.motion import mean_velocity
from pmfid.kernel.shapes import ShapeTable
from pmfid.models.drive import EquationModel
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
    Equation,
    Term,
)
from pmfid.models.shapes import Shape
from pmfid.types import Counts, Floats

#: Parts of a sample over which a hat is taken.
PARTS = 4
#: The measured velocity corrects the simulated one below this part of the cutoff.
SLOW = 0.3
#: A direction with less of the samples is none.
LEAST_PART = 0.02
#: The first node is at this quantile of the speed; they are no closer to each other, and to the last, than these parts.
SLOWEST, CLOSEST, APART = 0.02, 0.01, 0.05
#: Knots of the table that the kernel simulates.
KNOTS = 128
CURVE = "curve"
#: Speeds and friction of the nodes, forward and backward.
Sides = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class Remainder(Shape):
    """The part of a curve beyond Coulomb and viscous friction, at even speeds from 0 on, mean of both directions."""

    values: tuple[float, ...]
    step: float

    of_speed = True

    def table(self) -> ShapeTable:
        return ShapeTable("speed", self.values, step=self.step)

    @property
    def reads(self) -> str:
        return "(a curve)"


@dataclass(frozen=True)
class Basis:
    """speeds: of the nodes, forward and backward, from 0 on; regressors and instruments (n, 1 + k) of the mass and the
    hats, target (n,); used (N,) of the whole record; settle: samples that the filters take."""

    speeds: tuple[Floats, Floats]
    regressors: Floats
    instruments: Floats
    target: Floats
    used: NDArray[np.bool_]
    settle: int


def make_basis(model: IV, theta: Floats, u: Floats, counts: Counts, nodes: int) -> Basis:
    columns, roles = model.columns_at(theta, u, counts), model.equation.roles
    simulated = mean_velocity(model.equation, theta, model.dt / PARTS, np.repeat(u, PARTS))
    corrected = np.where(simulated == 0, 0.0, simulated + np.repeat(_slow(model, simulated, counts), PARTS))
    speeds, hats = [], []
    mass = model.equation.leading
    friction = np.delete(columns.zeta, mass, axis=1) @ np.delete(theta, mass)
    for side, role in ((1.0, COULOMB_FORWARD), (-1.0, COULOMB_BACKWARD)):
        own = _nodes(side * corrected, nodes, "forward" if side > 0 else "backward")
        whole = columns.zeta[:, roles[role]]
        # the share of a sample in which the axis moves this way is the kernel's, to the instant of a reversal
        hats += _with_first(whole, [h[columns.used] for h in _hats(model, side, side * corrected, own)])
        known = _model_friction(model, theta, own, side)
        alone = _with_first(whole, [h[columns.used] for h in _hats(model, side, side * simulated, own)])
        friction = friction - np.column_stack(alone) @ known
        speeds.append(own)
    curve = np.column_stack(hats)
    regressors = np.column_stack([columns.phi[:, mass], curve])
    instruments = np.column_stack([columns.zeta[:, mass], curve])
    # what hats make of the model's own friction, and what the kernel does, which is exact for it
    return Basis(
        (speeds[0], speeds[1]), regressors, instruments, columns.z - friction, columns.used, model.settle_samples
    )


def _with_first(whole: Floats, rising: list[Floats]) -> list[Floats]:
    return [whole - np.sum(rising, axis=0), *rising]


def _model_friction(model: IV, theta: Floats, speeds: Floats, side: float) -> Floats:
    """(k,) friction that the model has at speeds (k,) of one direction."""
    values = model.equation.role_values(theta)
    forward = side > 0
    body = (
        values[COULOMB_FORWARD if forward else COULOMB_BACKWARD]
        + speeds * (values[VISCOUS_FORWARD if forward else VISCOUS_BACKWARD])
    )
    sizes = dict(zip(model.equation.names, theta, strict=False))
    return np.asarray(body + sum(sizes[str(t.name)] * t.shape.at(speeds) for t in model.equation.shaped if t.shape))


def _slow(model: IV, simulated: Floats, counts: Counts) -> Floats:
    """(n,) what slowly departs in the counts from the simulated velocity (n parts,)."""
    from scipy.signal import filtfilt  # slow to import, and only this needs it

    moved = np.diff(counts) * model.encoder.resolution / model.dt
    late = np.r_[moved - simulated.reshape(-1, PARTS).mean(axis=1)[:-1], 0.0]
    part = 1 - np.exp(-SLOW * model.cutoff * model.dt)
    return np.asarray(filtfilt([part], [1.0, part - 1.0], late))


def _nodes(speed: Floats, nodes: int, direction: str) -> Floats:
    """0 and the quantiles of the positive speeds, each apart from the one before."""
    moving = speed[speed > 0]
    if moving.size < LEAST_PART * speed.size + 10 * nodes:
        raise NotIdentifiableError(f"the axis hardly moves {direction}: record a motion in both directions")
    found = np.asarray(np.quantile(moving, np.r_[SLOWEST, np.arange(1, nodes - 1) / (nodes - 1), 1.0]))
    kept = [0.0]
    for value in found[:-1].tolist():
        if value - kept[-1] > CLOSEST * found[-1] and found[-1] - value > APART * found[-1]:
            kept.append(value)
    return np.array([*kept, found[-1]])


def _hats(model: IV, side: float, speed: Floats, nodes: Floats) -> Iterator[Floats]:
    """The filtered hats (n,) of all nodes but the first, at speeds (n parts,), with the sign of the direction."""
    for j in range(1, nodes.size):
        unit = np.zeros(nodes.size)
        unit[j] = 1.0
        yield filter_force(side * np.where(speed > 0, np.interp(speed, nodes, unit), 0.0), model, speed.size // PARTS)


def bend_of(speeds: tuple[Floats, Floats]) -> Floats:
    """(rows, 1 + k): the square of what it makes of the parameters is the integral of the second derivative squared."""
    k = sum(own.size for own in speeds)
    rows, first = [], 1
    for own in speeds:
        h = np.diff(own) / own[-1]
        for j in range(1, own.size - 1):
            row = np.zeros(1 + k)
            width = (h[j - 1] + h[j]) / 2
            row[first + j - 1 : first + j + 2] = (
                np.array([1 / h[j - 1], -1 / h[j - 1] - 1 / h[j], 1 / h[j]]) / width**0.5
            )
            rows.append(row)
        first += own.size
    return np.array(rows)


def with_curve(estimator: IV, mass: float, sides: Sides) -> tuple[IV, Floats]:
    """The same method on the equation that has a curve in its simulated motion, and its parameters. sides: speeds and
    friction, forward and backward."""
    lines = [np.asarray(np.polyfit(speed, force, 1)) for speed, force in sides]
    even = np.linspace(0.0, max(speed[-1] for speed, _ in sides), KNOTS)
    remainders = [
        np.interp(even, *side) - np.polyval(line, np.minimum(even, side[0][-1]))
        for side, line in zip(sides, lines, strict=True)
    ]
    remainder = Remainder(tuple(np.mean(remainders, axis=0).tolist()), float(even[1]))
    terms = (
        Term("output", 2, "mass", "kg"),
        Term("forward_output", 1, "viscous_friction_forward", "N s/m"),
        Term("backward_output", 1, "viscous_friction_backward", "N s/m"),
        Term("forward", 0, "coulomb_friction_forward", "N"),
        Term("backward", 0, "coulomb_friction_backward", "N"),
        Term("friction", 0, CURVE, "", shape=remainder),
    )
    equation = Equation(terms, estimator.equation.known, dead_time=estimator.equation.dead_time)
    (slope, level), (slope_back, level_back) = (np.maximum(line, 0.0).tolist() for line in lines)
    theta = np.array([mass, slope, slope_back, level, level_back, 1.0])
    return like(IV, estimator, model=EquationModel(equation), prefilter_zeros=None), theta
