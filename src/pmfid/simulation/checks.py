"""Checks of arguments that the whole room shares."""

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from pmfid.types import Floats


def check_number(name: str, value: float, *, above: float = -np.inf, remedy: str = "pass a finite number") -> None:
    """Raise ValueError unless `value` is finite and > `above`."""
    if not (isfinite(value) and value > above):
        bound = "finite" if above == -np.inf else f"finite and > {above:g}"
        raise ValueError(f"{name} must be {bound}, got {value}; {remedy}")


def check_whole(name: str, value: int, low: int, high: float, remedy: str) -> None:
    """Raise ValueError unless `value` is a whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        bound = f"of at least {low}" if high == np.inf else f"in [{low}, {high:g}]"
        raise ValueError(f"{name} must be a whole number {bound}, got {value}; {remedy}")


def check_signal(name: str, values: ArrayLike) -> Floats:
    """Return a float64 copy (n,) of `values`; raise ValueError unless 1-D, finite and n >= 1."""
    signal = np.array(values, dtype=np.float64, order="C")
    if np.ndim(values) != 1 or signal.size == 0:
        raise ValueError(f"{name} must have shape (n,), n >= 1, got {np.shape(values)}; pass one value per sample")
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] is {signal[bad[0]]}, it must be finite; repair or leave out that sample")
    return signal


def sample_times(samples: int, dt: float) -> Floats:
    """Return the instants k dt, (samples,)."""
    return np.arange(samples, dtype=np.float64) * np.float64(dt)
