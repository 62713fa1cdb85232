"""The travel that an output tells: one that begins anew, as an angle, and a velocity, which is the change of it.

Of a velocity the level of the position is gone, and its error adds up: the position walks with its noise and runs away
with its offset. Mass and friction live on the changes, and their error bars, which come from how the record scatters,
hold; what depends on the place (a spring, gravity, cogging) cannot be told from such a record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid.session.config import Axis

__all__ = ["measure_travel"]

#: Velocities are multiples of a step where they are within this part of it.
WHOLE = 1e-3


def _position_of(velocity: Floats, dt: float, resolution: float) -> tuple[Floats, str]:
    """The position (n,) from 0 on of a velocity (n,) that is sampled every dt [s], and how it was found, for people.

    A drive that takes differences of its counts logs multiples of resolution / dt, the mean over the interval that
    ends: these add up to the counts again. Any other velocity runs along a line between samples.
    """
    steps = velocity * (dt / resolution)
    if np.any(steps) and np.all(np.abs(steps - np.rint(steps)) < WHOLE):
        return np.cumsum(np.rint(steps)) * resolution, "the velocity is the change of counts, which are added up"
    line = np.r_[0.0, np.cumsum(velocity[1:] + velocity[:-1])] * (dt / 2)
    return line, "the velocity is integrated along lines between samples: an offset of it grows into the position"


def measure_travel(y: Floats, dt: float, axis: Axis) -> tuple[Floats, tuple[str, ...]]:
    """The output as one that does not begin anew, and no velocity; what was done, for people."""
    if axis.record.output_kind == "velocity":
        position, how = _position_of(y, dt, axis.encoder.resolution)
        return position, (how,)
    span = axis.encoder.range
    if span is None:
        return y, ()
    if axis.encoder.bits is not None:
        raise UsageError("[encoder] range and bits both say where the output begins anew: drop one of them")
    period = span if axis.record.output_kind == "position" else np.rint(span / axis.encoder.resolution)
    unwrapped = np.unwrap(y, period=period)
    times = int(np.count_nonzero(np.abs(np.diff(unwrapped) - np.diff(y)) > period / 2))
    return unwrapped, (f"the output began anew {times} time{'s' * (times != 1)} (undone)",) if times else ()
