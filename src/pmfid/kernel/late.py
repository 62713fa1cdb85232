"""An input that acts late as the kernel holds it (csrc/pmf_dead_time.h, csrc/pmf_lag.h)."""

from __future__ import annotations

import math

import numpy as np

#: exp(-t / lag) over a part of a sample: its end, its integral, and the integral of t times it; t in samples.
Decay = tuple[float, float, float]


def late_values(
    dt: float, dead_time: float, lag: float, room: int | None = None, precision: str = "float64"
) -> dict[str, object]:
    """The fields of `pmf_late_config_t` for a dead time and a lag [s]; room: whole samples of the longest dead time,
    None: of this one."""
    room = max(1, math.ceil(dead_time / dt)) if room is None else room
    real = np.float32 if precision == "float32" else np.float64
    samples = min(float(real(dead_time) * real(1 / dt)), float(room))  # as the kernel reckons it
    return {
        "room": room,
        "rate": 1 / dt,
        "dead_time": dead_time,
        "found": 0,
        "within": 0,
        "counts": 0.0,
        "growth": 1.0,
        "lags": int(lag > 0),
        "decay": decays(samples - math.floor(samples), lag / dt) if lag > 0 else [(0.0, 0.0, 0.0)] * 2,
    }


def decays(part: float, lag: float) -> list[Decay]:
    """Of a lag > 0 [samples] over `part` of a sample and over the rest of it."""
    return [_decay(part, lag), _decay(1 - part, lag)]


def _decay(time: float, lag: float) -> Decay:
    rest, gone = math.exp(-time / lag), -math.expm1(-time / lag)
    return rest, lag * gone, lag * (lag * gone - time * rest)
