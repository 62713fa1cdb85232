"""The travel of an output on an even grid: a position without its wraps, or the integral of a velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import UsageError
from pmfid.records.column_checks import RECORD_WHOLE
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid.config.axis import Axis


def integrate_velocity(velocity: Floats, dt: float) -> Floats:
    """Return the position (n,) of a velocity (n,) that is linear between samples. The position starts at 0."""
    return np.asarray(np.r_[0.0, np.cumsum(velocity[1:] + velocity[:-1])] * (dt / 2))


def _position_of(velocity: Floats, dt: float, resolution: float) -> tuple[Floats, str]:
    """Return the position (n,) of a velocity (n,) that is sampled every dt [s], and a description of the method.

    The position starts at 0. A drive that differentiates its counts logs multiples of resolution / dt, which are means
    over the preceding interval. The sum of the logged multiples gives the counts exactly. Any other velocity is taken
    as linear between samples.
    """
    steps = velocity * (dt / resolution)
    if np.any(steps) and np.all(np.abs(steps - np.rint(steps)) < RECORD_WHOLE):
        return np.cumsum(np.rint(steps)) * resolution, (
            "the velocity is the change of the counts, and the position is their sum"
        )
    return integrate_velocity(velocity, dt), (
        "the velocity is integrated along lines between samples, so an offset of the velocity makes the position drift"
    )


def measure_travel(y: Floats, dt: float, axis: Axis) -> tuple[Floats, tuple[str, ...]]:
    """Return the travel of the output, unwrapped or integrated, and notes for people."""
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
