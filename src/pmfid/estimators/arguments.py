"""What estimators are given, checked: numbers, records as arrays, counts."""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.types import Floats, Numbers


def check_positive(name: str, value: float, what: str) -> None:
    """Raises UsageError unless value is positive and finite."""
    if not (isinstance(value, Real) and math.isfinite(value) and value > 0):
        raise UsageError(f"{name} must be positive and finite, got {value!r}; {what}")


def check_arrays(u: ArrayLike, counts: ArrayLike) -> tuple[Floats, NDArray[np.int64]]:
    """u and counts as contiguous (n,) arrays; raises UsageError where they do not fit each other."""
    u_array = np.ascontiguousarray(numbers("u", u), dtype=np.float64)
    counts_array = np.ascontiguousarray(integer_counts(counts), dtype=np.int64)
    if u_array.ndim != 1 or u_array.shape != counts_array.shape:
        raise UsageError(
            f"u and counts must be two arrays of the same length, got {u_array.shape} and {counts_array.shape}"
        )
    return u_array, counts_array


def numbers(name: str, values: ArrayLike) -> Numbers:
    """An array of real numbers in their own type; raises UsageError where they are none, or rows differ in length."""
    if np.ma.is_masked(values):
        raise UsageError(f"{name} has masked elements, which a plain array would show as numbers; fill them first")
    try:
        array = np.asarray(values)
        array = array if array.dtype.kind in "biufc" else array.astype(np.float64)
        array = np.require(array, requirements="A")  # C may not load a number across its alignment
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0, object)
    if array.dtype.kind not in "biuf" or values is None:
        raise UsageError(f"{name} must be an array of real numbers, with rows of one length")
    return array


def integer_counts(counts: ArrayLike) -> Numbers:
    """Counts of any shape as an array of whole numbers; raises UsageError where they are none."""
    given = numbers("counts", counts)
    if given.dtype.kind in "iu":
        return given
    missing = np.argwhere(~np.isfinite(given))
    if missing.size:
        where = ", ".join(str(index) for index in missing[0])
        raise UsageError(
            f"counts are NaN or infinite in {len(missing)} places, the first at index {where}: repeat the count before "
            "where a sample is missing; of a transfer function, NaN in the output of an Experiment leaves it out"
        )
    if not np.array_equal(given, np.round(given)):
        raise UsageError("counts must be integers; use pmfid.quantize(position, resolution) for a position")
    if np.any(np.abs(given) >= 2.0**63):
        raise UsageError(
            f"counts reach {np.max(np.abs(given)):.3g}, beyond 64 bits: give them modulo 2^bits, as integers"
        )
    return np.round(given).astype(np.int64)


def hold_last_input(u: Floats) -> Floats:
    """u (n,) with the last finite value in place of those that are not, as the kernel does it."""
    last = np.maximum.accumulate(np.where(np.isfinite(u), np.arange(1, u.size + 1), 0))
    return np.ascontiguousarray(np.r_[0.0, u][last])


def check_size(u: Floats) -> None:
    """Raises UsageError where squares of the input (n,) would leave the number format."""
    size = np.max(np.abs(u), initial=0.0, where=np.isfinite(u))
    if size > 0 and not 1e-100 < size < 1e100:
        raise UsageError(f"the largest input is {size:.3g}: no drive has that; check the column and input_scale")
