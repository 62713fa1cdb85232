"""The travel of an output that wraps, as an angle, or that is a velocity.

An integrated velocity has no absolute position, and its error accumulates: the position drifts with the noise and the
offset. Mass and friction depend on changes of the position alone, so their standard errors hold. Forces that depend on
the position (a spring, gravity, cogging) cannot be identified from such a record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid.session.config import Axis

__all__ = ["measure_travel"]

#: Largest distance of a velocity from a multiple of a step, as a part of the step.
WHOLE = 1e-3


def _position_of(velocity: Floats, dt: float, resolution: float) -> tuple[Floats, str]:
    """The position (n,), which starts at 0, of a velocity (n,) that is sampled every dt [s], and the method, for
    people.

    A drive that differentiates its counts logs multiples of resolution / dt, the mean over the interval that ends.
    These add up to the counts again. Any other velocity is linear between samples.
    """
    steps = velocity * (dt / resolution)
    if np.any(steps) and np.all(np.abs(steps - np.rint(steps)) < WHOLE):
        return np.cumsum(np.rint(steps)) * resolution, "the velocity is the change of counts, which are added up"
    line = np.r_[0.0, np.cumsum(velocity[1:] + velocity[:-1])] * (dt / 2)
    return line, "the velocity is integrated along lines between samples: an offset of it grows into the position"


def measure_travel(y: Floats, dt: float, axis: Axis) -> tuple[Floats, tuple[str, ...]]:
    """The travel of the output, unwrapped or integrated, and notes for people."""
    if axis.record.output_kind == "velocity":
        position, how = _position_of(y, dt, axis.encoder.resolution)
        return position, (how,)
    span = axis.encoder.range
    if span is None:
        return y, ()
    if axis.encoder.bits is not None:
        raise UsageError("[encoder] range and bits both say where the output wraps: drop one of them")
    period = span if axis.record.output_kind == "position" else np.rint(span / axis.encoder.resolution)
    unwrapped = np.unwrap(y, period=period)
    times = int(np.count_nonzero(np.abs(np.diff(unwrapped) - np.diff(y)) > period / 2))
    return unwrapped, (f"the output wrapped {times} time{'s' * (times != 1)} (undone)",) if times else ()
