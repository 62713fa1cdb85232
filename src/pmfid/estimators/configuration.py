"""Arguments and configurations of estimators."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from inspect import cleandoc, get_annotations
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.types import Floats, Numbers

if TYPE_CHECKING:
    from _typeshed import DataclassInstance as Configured


def check_positive(name: str, value: float, what: str) -> None:
    """Raise UsageError unless `value` is positive and finite."""
    if not (isinstance(value, Real) and math.isfinite(value) and value > 0):
        raise UsageError(f"{name} must be positive and finite, got {value!r}; {what}")


def check_edges(lines: int | None, tick: float, dt: float, most: int | None = None) -> None:
    """Raise UsageError unless `lines` is a number of counts up to `most`, and `tick` [s] is shorter than `dt` [s]."""
    if lines is not None:
        count = whole_number("lines", lines, 1, "it is the number of counts per turn, or None for a linear scale")
        if most is not None and count > most:
            raise UsageError(
                f"lines must be a whole number of at most {most}, got {count}; give None for a linear scale"
            )
    if not (isinstance(tick, Real) and 0 <= tick < dt):
        raise UsageError(f"tick must be the period of the timer in s, below dt = {dt:g}, got {tick!r}")


def check_arrays(u: ArrayLike, counts: ArrayLike) -> tuple[Floats, NDArray[np.int64]]:
    """Return u and counts as contiguous arrays (n,). Raises UsageError if they do not match."""
    u_array = np.ascontiguousarray(numbers("u", u), dtype=np.float64)
    counts_array = np.ascontiguousarray(integer_counts(counts), dtype=np.int64)
    if u_array.ndim != 1 or u_array.shape != counts_array.shape:
        raise UsageError(
            f"u and counts must be two arrays of the same length, got {u_array.shape} and {counts_array.shape}"
        )
    return u_array, counts_array


def numbers(name: str, values: ArrayLike) -> Numbers:
    """Return an array of real numbers in their own type. Raises UsageError if a value is not a number, or if rows
    differ in length.
    """
    if np.ma.is_masked(values):
        raise UsageError(f"{name} has masked elements, and pmfid would read them as numbers; fill them first")
    try:
        array = np.asarray(values)
        array = array if array.dtype.kind in "biufc" else array.astype(np.float64)
        array = np.require(array, requirements="A")  # C cannot load a number from an address that is not aligned
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0, object)
    if array.dtype.kind not in "biuf" or values is None:
        raise UsageError(f"{name} must be an array of real numbers with rows of equal length")
    return array


def integer_counts(counts: ArrayLike) -> Numbers:
    """Return counts of any shape as an array of whole numbers. Raises UsageError if a count is no whole number."""
    given = numbers("counts", counts)
    if given.dtype.kind in "iu":
        return given
    missing = np.argwhere(~np.isfinite(given))
    if missing.size:
        where = ", ".join(str(index) for index in missing[0])
        raise UsageError(
            f"counts are NaN or infinite in {len(missing)} places, first at index {where}: replace a "
            "missing count with the count before it. Only the output of an Experiment may contain NaN, "
            "for a transfer function"
        )
    if not np.array_equal(given, np.round(given)):
        raise UsageError("counts must be integers; use pmfid.quantize(position, resolution) for a position")
    if np.any(np.abs(given) >= 2.0**63):
        raise UsageError(
            f"counts reach {np.max(np.abs(given)):.3g}, beyond the range of 64 bits: give them modulo "
            "2^bits, as integers"
        )
    return np.round(given).astype(np.int64)


def hold_last_input(u: Floats) -> Floats:
    """Return u (n,) with the last finite value in place of each value that is not finite, as in the kernel."""
    last = np.maximum.accumulate(np.where(np.isfinite(u), np.arange(1, u.size + 1), 0))
    return np.ascontiguousarray(np.r_[0.0, u][last])


def check_size(u: Floats) -> None:
    """Raise UsageError if squares of the input (n,) would exceed the number format."""
    size = np.max(np.abs(u), initial=0.0, where=np.isfinite(u))
    if size > 0 and not 1e-100 < size < 1e100:
        raise UsageError(f"the largest input is {size:.3g}, too large for any drive; check the column and input_scale")


#: Name of the attribute with a class's original docstring.
OWN_HELP = "_own_help"
E = TypeVar("E")
C = TypeVar("C", bound="Configured")


@dataclass(frozen=True, eq=False, repr=False)
class ByName(Mapping[str, float]):
    """Immutable mapping from parameter names to numbers; equal to a dict with the same content."""

    pairs: tuple[tuple[str, float], ...]

    def __getitem__(self, name: str) -> float:
        return dict(self.pairs)[name]

    def __iter__(self) -> Iterator[str]:
        return (name for name, _ in self.pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def __hash__(self) -> int:
        return hash(frozenset(self.pairs))

    def __repr__(self) -> str:
        return repr(dict(self.pairs))


def explain_inherited(cls: type) -> None:
    """Append the docstrings of all bases that add arguments to the docstring of a class.

    The `help` of a method then explains all its arguments.
    """
    own = cls.__dict__.get("__doc__")
    if own is None:
        return
    setattr(cls, OWN_HELP, cleandoc(own))
    bases = [base for base in cls.__mro__[1:] if _arguments_of(base)]
    parts = [
        f"As every `{base.__name__}`:\n{base.__dict__.get(OWN_HELP) or cleandoc(base.__doc__ or '')}" for base in bases
    ]
    cls.__doc__ = "\n\n".join([cleandoc(own), *parts])


def _arguments_of(cls: type) -> list[str]:
    """Return the names of the fields that a class adds to its bases."""
    return [name for name, kind in get_annotations(cls).items() if not str(kind).startswith("ClassVar")]


def freeze(estimator: Configured) -> None:
    """Replace the lists, arrays and dicts of an estimator's configuration by immutable copies."""
    for name, value in configuration_of(estimator).items():
        if isinstance(value, Mapping) and not isinstance(value, ByName):
            object.__setattr__(estimator, name, ByName(tuple(value.items())))
        elif isinstance(value, list | np.ndarray):
            object.__setattr__(estimator, name, tuple(value))


def configuration_of(estimator: Configured) -> dict[str, object]:
    """Return the arguments of an estimator by name."""
    return {field.name: getattr(estimator, field.name) for field in fields(estimator) if field.init}


def construct_estimator(cls: Callable[..., E], configuration: Mapping[str, object]) -> E:
    """Return a new estimator of a class, without samples."""
    return cls(**configuration)


def resume_estimator(cls: Callable[..., Any], configuration: Mapping[str, object], state: bytes) -> Any:
    """Return a new estimator of a class, in a saved state."""
    estimator = construct_estimator(cls, configuration)
    estimator.set_state(state)
    return estimator


def change_arguments(estimator: C, changes: Mapping[str, object]) -> C:
    """Return an estimator of the same class with some arguments changed, without samples.

    The function works like `dataclasses.replace`, for a mapping.
    """
    return construct_estimator(type(estimator), configuration_of(estimator) | dict(changes))


def like(cls: type[C], estimator: Configured, **changes: object) -> C:
    """Return an estimator of another class with the arguments that both classes share, and with the changes.

    Arguments with parameter names (`initial`) are kept only with the same model, because another model has other
    parameters.
    """
    taken, given = {field.name for field in fields(cls) if field.init}, configuration_of(estimator)
    kept = {name: value for name, value in given.items() if name in taken}
    if changes.get("model", given["model"]) != given["model"]:
        kept = {name: value for name, value in kept.items() if not isinstance(value, ByName)}
    return construct_estimator(cls, kept | changes)
