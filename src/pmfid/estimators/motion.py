"""The motion of a machine's equation under an input, simulated by the kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pmfid.kernel.late import Decay, decays
from pmfid.kernel.shapes import shape_bytes
from pmfid.models.equation import LATE, MASS, VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation
from pmfid.types import Floats

#: Parts of a sample in the simulation of forces with a shape and of reversals under a lagging input: by default, and
#: at most.
PARTS, MOST_PARTS = 4, 16
#: Damping that the kernel gives a body in every step, so that it may divide by it.
LITTLE_DAMPING = 1e-9


def mean_velocity(
    equation: Equation,
    theta: Floats,
    dt: float,
    u: Floats,
    velocity: float = 0.0,
    position: float = 0.0,
    parts: int = PARTS,
    before: Floats | None = None,
    on_top: Floats | None = None,
) -> Floats:
    """(n,) of every interval at theta (p,), shape parameters included, under u (n,), held; velocity, position: at the
    start, the position as the equation counts it. parts: of a sample, of an equation with shapes or a lag; without them
    the motion is exact. before: inputs before the first (m,), for a dead time or a lag; None: zero. on_top:
    (n,) what acts at once in addition to the input, in its unit."""
    return simulate_motion(equation, theta, dt, u, velocity, position, parts, before, on_top)[0]


def simulate_motion(
    equation: Equation,
    theta: Floats,
    dt: float,
    u: Floats,
    velocity: float = 0.0,
    position: float = 0.0,
    parts: int = PARTS,
    before: Floats | None = None,
    on_top: Floats | None = None,
) -> tuple[Floats, float]:
    """`mean_velocity`, and the velocity at the end."""
    from pmfid import _kernel64

    past = np.zeros(1) if before is None else before
    known = equation.known_at(np.asarray(theta)[len(equation.names) :])
    roles, shapes = known.role_values(theta), shape_bytes(known.shapes)
    if not (shapes or known.lag):
        found = _kernel64.simulate(roles, known.input_gain, dt, u, velocity, position, b"", past, None, on_top)
        return np.asarray(found[0]), float(found[3])
    for viscous in (VISCOUS_FORWARD, VISCOUS_BACKWARD):  # as little in all parts as in one step
        roles[viscous] = max(roles[viscous] - (parts - 1) * LITTLE_DAMPING * roles[MASS] / dt, 0.0)
    inputs = np.repeat(u, parts)
    extra = None if on_top is None else np.repeat(on_top, parts)
    past, lagging = np.repeat(past, parts), _decays(known, roles, dt / parts)
    found = _kernel64.simulate(
        roles, known.input_gain, dt / parts, inputs, velocity, position, shapes, past, lagging, extra
    )
    return np.asarray(found[0].reshape(-1, parts).mean(axis=1)), float(found[3])


def _decays(equation: Equation, roles: Sequence[float], dt: float) -> list[Decay] | None:
    """What the kernel needs for the lag of an equation, in steps of dt [s]; None: there is none."""
    if not equation.lag:
        return None
    late = max(roles[LATE] / dt, 0.0)
    return decays(late - math.floor(late), float(equation.lag) / dt)


def parts_for(equation: Equation, theta: Floats, dt: float, u: Floats, allowed: float) -> int:
    """Parts of a sample with which the position is right to a root mean square of `allowed` [unit of y]; the error of
    such a scheme falls with their square."""
    parts = 1
    if equation.shaped or equation.lag:
        coarse = mean_velocity(equation, theta, dt, u, parts=parts)
        while parts < MOST_PARTS:
            fine = mean_velocity(equation, theta, dt, u, parts=2 * parts)
            if not np.std(np.cumsum(coarse - fine)) * dt > allowed:
                break
            parts, coarse = 2 * parts, fine
    return parts
