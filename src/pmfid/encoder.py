"""Encoder: its data sheet, its constants for the kernel, and the position of each count."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.units import Quantity, quantity

#: A text for each property of an encoder that has a unit.
EXAMPLES = {"resolution": "0.01 deg", "max_speed": "3000 rpm"}
#: Acceleration times dt^2 [counts] for which the direction tracker is tuned (Kalata's tracking index). With the value
#: 10, the tracker follows a piecewise constant acceleration within a sample. The chosen value still damps the staircase
#: of two counts.
TRACKING_INDEX = 10.0


@dataclass(frozen=True)
class Encoder:
    """An incremental encoder.

    Parameters
    ----------
    resolution : float or str
        Unit of position per count, > 0. A text has a unit, as in AXIS.toml: "0.01 deg" or "4096 counts/rev".
    bits : int
        Width of the counter, 1 to 32; the counter wraps at 2**bits.
    standstill_time : float
        Time without a count after which the axis counts as being at rest [s], > 0.
    max_speed : float or str, optional
        Highest speed [unit/s], or a text such as "3000 rpm". A faster change in one sample is flagged as a jump and
        left out.
    guard : bool
        If True, samples of a machine that no motion explains are flagged and replaced, even without max_speed. Examples
        are a counter that was set to another value, a wrong reading, and a spike of the input. Recursive estimators
        judge a sample by the counts after it, so their estimates lag (`RecursiveEstimator.delay`). False lets every
        sample in without a delay. The guard ignores the output of a process and samples with given steps.

    Raises
    ------
    UsageError
        A value is outside these bounds.

    Examples
    --------
    >>> from pmfid import Encoder
    >>> Encoder(0.5).position([0, 1, 3])
    array([0.25, 0.75, 1.75])
    >>> round(Encoder("4096 counts/rev").resolution, 6)
    0.001534
    """

    resolution: float
    bits: int
    standstill_time: float
    max_speed: float | None
    guard: bool

    def __init__(
        self,
        resolution: float | str,
        bits: int = 32,
        standstill_time: float = 0.2,
        max_speed: float | str | None = None,
        guard: bool = True,
    ) -> None:
        values = {
            "resolution": _read_quantity("resolution", resolution, ("length", "angle")),
            "bits": bits,
            "standstill_time": standstill_time,
            "max_speed": _read_quantity("max_speed", max_speed, ("speed", "angular speed")),
            "guard": guard,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        _positive("resolution", self.resolution, "unit of position per count, as on the data sheet")
        if not 1e-30 < self.resolution < 1e30:
            raise UsageError(f"resolution = {self.resolution:g} per count is impossible for an encoder; check the unit")
        _positive("standstill_time", self.standstill_time, "s")
        if self.max_speed is not None:
            _positive("max_speed", self.max_speed, "unit/s, or leave it out")
        if not isinstance(self.bits, Integral) or not 1 <= self.bits <= 32:
            raise UsageError(
                f"bits must be a whole number from 1 to 32, got {self.bits!r}; give the width of the counter"
            )

    def kernel_config(self, dt: float) -> dict[str, float]:
        """Return the encoder's part of the kernel configuration for the sample period dt [s]."""
        return {
            "velocity_per_count": self.resolution / dt,
            "position_per_count": self.resolution,
            "count_mask": 2**self.bits - 1,
            "max_change": self._max_change(dt),
            "process": 0,
            "standstill_samples": max(1, round(min(self.standstill_time / dt, 2**32 - 1))),
            "guard": 0,
            "rate": 0.0,
            "push": TRACKING_INDEX * TRACKING_INDEX,
            "turns": 0,
            "misread": 0,
            **tracker_gains(TRACKING_INDEX),
        }

    @property
    def rounding_variance(self) -> float:
        """Variance of a rounding error that is spread evenly over one count [square of the unit of position]."""
        return self.resolution * self.resolution / 12

    def _max_change(self, dt: float) -> int:
        if self.max_speed is None:
            return 0
        return max(1, math.ceil(min(self.max_speed * dt / self.resolution, 2**31 - 1)))

    def position(self, counts: ArrayLike, zero: int = 0) -> NDArray[np.float64]:
        """Return the position (n,) of each count, in the middle of its step and in the unit of the resolution.

        `counts` (n,) are integers; a counter that wraps is unwrapped. `zero` is the count at position 0.
        """
        counts = np.asarray(counts, np.int64)
        half = 2 ** (self.bits - 1)
        change = (np.diff(counts) + half) % (2 * half) - half
        unwrapped = counts[:1].repeat(counts.size) + np.r_[0, np.cumsum(change)][: counts.size]
        return np.asarray((unwrapped - zero + 0.5) * self.resolution)


def quantize(y: ArrayLike, resolution: float) -> NDArray[np.int64]:
    """Return the counts of an encoder, floor(y / resolution) (paper eq. 3).

    Parameters
    ----------
    y : array_like (n,)
        Position.
    resolution : float
        Unit of y per count.

    Returns
    -------
    ndarray of int64 (n,)

    Examples
    --------
    >>> from pmfid import quantize
    >>> quantize([0.0, 0.9, -0.1], 0.5)
    array([ 0,  1, -1])
    """
    _positive("resolution", resolution, "unit of position per count")
    return np.floor(np.asarray(y, float) / resolution).astype(np.int64)


#: Number of counts in the range of an output that is a measured number. The resolution exceeds any converter's.
FINE = 2**30


def fine_counts(y: NDArray[np.float64]) -> tuple[Encoder, NDArray[np.int64]]:
    """Return an encoder for a finite output y (n,), and the counts (n,). The encoder is so fine that quantisation has
    no effect.
    """
    size = float(np.max(np.abs(y), initial=0.0)) or 1.0
    resolution = size / FINE
    return Encoder(resolution), quantize(y, resolution)


@cache
def tracker_gains(tracking_index: float) -> dict[str, float]:
    """Return the steady gains of a Kalman filter and of its one-step smoother, for piecewise constant white
    acceleration.

    The position is in counts, the velocity in counts per sample (Kalata 1984). The smoother's gains carry an innovation
    back to the velocities one and two samples earlier (Rauch, Tung and Striebel 1965).
    """
    # Plain numbers, because a BLAS rounds by the kind of processor, and these gains decide the bits of estimates.
    noise, (xx, xv, vv) = tracking_index * tracking_index, (1.0, 0.0, 1.0)  # the predicted covariance
    for _ in range(200):  # the Riccati recursion contracts by a constant factor, so the result after 200 steps is exact
        position, velocity = xx / (xx + 1.0), xv / (xx + 1.0)
        f_xx, f_xv, f_vv = xx - position * xx, xv - position * xv, vv - velocity * xv
        carried = f_xv + f_vv
        xx, xv, vv = f_xx + f_xv + carried + 0.25 * noise, carried + 0.5 * noise, f_vv + noise
    size = xx * vv - xv * xv
    to_x = ((f_xx + f_xv) * vv - f_xv * xv) / size, (f_xv * xx - (f_xx + f_xv) * xv) / size
    to_v = (carried * vv - f_vv * xv) / size, (f_vv * xx - carried * xv) / size
    back = to_x[0] * position + to_x[1] * velocity, to_v[0] * position + to_v[1] * velocity
    return {
        "position_gain": position,
        "velocity_gain": velocity,
        "smooth_end": back[1],
        "smooth_start": to_v[0] * back[0] + to_v[1] * back[1],
    }


def _read_quantity(name: str, value: object, of: tuple[str, ...]) -> object:
    """Return a text with a unit as a number in SI, and any other value unchanged.

    Raises UsageError for a text without a number, and for a unit that measures none of the quantities `of`.
    """
    if not isinstance(value, str):
        return value
    try:
        read = quantity(value)
    except ValueError as error:
        raise UsageError(f"{name} = {value!r}: {error}") from None
    if not isinstance(read, Quantity) or read.unit.of not in of:
        raise UsageError(
            f'{name} = {value!r} is not a {" or ".join(of)}; give a number with its unit, such as "{EXAMPLES[name]}"'
        )
    return read


def _positive(name: str, value: float, remedy: str) -> None:
    if not (isinstance(value, Real) and math.isfinite(value) and value > 0):
        raise UsageError(f"{name} must be positive and finite, got {value!r}: {remedy}")
