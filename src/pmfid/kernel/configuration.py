"""The configuration of the kernel, filled by field names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from pmfid.elementary import exp, expm1
from pmfid.kernel.structures import Structured, constants_of, structures

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Values of a structure by field names. Unnamed elements at the end of an array are 0.
Values = Mapping[str, object]
Stages = Sequence[tuple[int, float, float, float]]
#: The coefficients of a stage grow with the step, belong to a derivative, or also depend on the step's mean square.
Kind = Literal["lasting", "changing", "bending"]
#: Rule by which a stage follows a varying step: 1 if its signals belong to the preceding interval, else 0; the kind;
#: the pole times half a sample period.
Rate = tuple[int, Kind, float]
#: Number of the rule of each stage (counted from 1; 0 for no rule), and the rules.
Rates = tuple[Sequence[int], Sequence[Rate]]
Columns = Sequence[Sequence[tuple[int, float]]]


def kernel_of(precision: str, config: Structured) -> Kernel:
    """Return a kernel in its initial state. Raises ValueError for a configuration that the kernel refuses."""
    from pmfid import _kernel32, _kernel64

    module = _kernel32 if precision == "float32" else _kernel64  # typed alike
    return cast("Kernel", module.Kernel(config.tobytes()))


def make_config(
    precision: str,
    stages: Stages,
    columns: Columns,
    *,
    encoder: Values,
    direct: Values,
    settle_samples: int,
    first_samples: int | None = None,
    instrument: Values | None = None,
    auxiliary: Values | None = None,
    late: Values | None = None,
    shapes: Values | None = None,
    rates: Rates = ((), ()),
) -> Structured:
    """Return the configuration of a kernel.

    `stages` has rows (source, a, b0, b1), and `columns` has a list of (node, weight) for each column. `encoder`,
    `direct`, `instrument`, `auxiliary` and `late` hold the fields of the C structures by name. Without `auxiliary` the
    kernel simulates no model and has no `instrument`. Without `late` the input acts at once. `shapes` replaces the
    field `shapes` of a missing `auxiliary`. `first_samples` defaults to `settle_samples`. `rates` are the rules for a
    varying step. Raises ValueError if a size is exceeded, or a field is missing or unknown.
    """
    parameters = max(cast("int", one["n_parameters"]) for one in (direct, instrument or direct))
    config = np.zeros((), structures(None, precision)["pmf_config_t"])
    values = {
        "settle_samples": settle_samples,
        "first_samples": settle_samples if first_samples is None else first_samples,
        "encoder": encoder,
        "network": network_values(stages, columns, parameters, rates),
        "direct": direct,
        "auxiliary": auxiliary,
        "late": late,
        "instrument": instrument,
    }
    fill(config, values)
    if shapes is not None and auxiliary is None:
        fill(config["auxiliary"]["shapes"], shapes)
    return config


def network_values(stages: Stages, columns: Columns, parameters: int, rates: Rates = ((), ())) -> dict[str, object]:
    """Return the fields of `pmf_network_config_t`. Raises ValueError if the kernel has no room for the stages or
    columns.
    """
    sizes, taps = constants_of(None), [tap for column in columns for tap in column]
    names = ("PMF_MAX_STAGES", "PMF_MAX_TAPS", "PMF_MAX_COLUMNS", "PMF_MAX_PARAMETERS")
    room = [sizes[name] for name in names]
    if any(
        number > most for number, most in zip((len(stages), len(taps), len(columns), parameters), room, strict=True)
    ):
        raise ValueError(
            f"the equation needs {len(stages)} stages, {len(taps)} taps and {parameters} parameters, and the kernel "
            f"holds only {room[0]}, {room[1]} and {room[3]}; use a lower order"
        )
    if len(rates[1]) >= sizes["PMF_MAX_RATES"]:
        raise ValueError(
            f"the stages have {len(rates[1])} different step responses, and the kernel holds only "
            f"{sizes['PMF_MAX_RATES'] - 1}; "
            "give fewer prefilter_zeros"
        )
    return {
        "n_stages": len(stages),
        "n_columns": len(columns),
        # with a varying step, a is unused: 0 marks states whose memories are those of signals alone
        "stage": [
            (source, 0.0 if rates[1] else a, b0, b1, rate)
            for (source, a, b0, b1), rate in zip(stages, rates[0] or [0] * len(stages), strict=True)
        ],
        "tap_end": np.cumsum([len(column) for column in columns]),
        "tap": taps,
        "n_rates": len(rates[1]) + 1 if rates[1] else 0,
        "rates": _rate_values(rates[1]),
    }


def _rate_values(rates: Sequence[Rate]) -> dict[str, object]:
    """Return the fields of `pmf_rates_t`."""
    rows: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)] if rates else []
    kinds: tuple[Kind, ...] = ("changing", "lasting", "bending")  # in the order of the fields gain, growth and square
    for late, kind, half in rates:
        rows.append((1.0 - late, float(late), half, 1.0, *((1 + half) * (kind == one) for one in kinds)))
    names = ("now", "before", "half", "keep", "gain", "growth", "square")
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def fill(structure: Structured, values: Values) -> None:
    """Set every field of a structure (0-d). The value None sets a field to zeros.

    Raises ValueError if a field has no value, a value has no field, or an array is too long.
    """
    fields = structure.dtype.names or ()
    if set(fields) != set(values):
        missing, unknown = sorted(set(fields) - set(values)), sorted(set(values) - set(fields))
        raise ValueError(f"a configuration needs just the fields of pmf.h: missing {missing}, unknown {unknown}")
    for name, value in values.items():
        if isinstance(value, Mapping):
            fill(structure[name], value)
        elif value is not None:
            _set(structure, name, value)


def _set(structure: Structured, name: str, value: object) -> None:
    field = structure[name]
    if field.ndim == 0:
        structure[name] = value
        return
    rows: ArrayLike
    if field.dtype.names:  # a sequence of structures, each given as a tuple
        rows = cast("Sequence[tuple[float, ...]]", value)
        shape: tuple[int, ...] = (len(rows),)
    else:
        rows = np.asarray(value, field.dtype)
        shape = rows.shape
    if len(shape) != field.ndim or any(size > most for size, most in zip(shape, field.shape, strict=True)):
        raise ValueError(f"{name} has the shape {shape}, but the kernel holds only {field.shape}")
    if all(shape):
        field[tuple(slice(size) for size in shape)] = rows


_KERNEL = constants_of(None)
_OF = {name: _KERNEL[f"PMF_OF_{name.upper()}"] for name in ("speed", "square", "place", "wave")}
#: Largest number of forces of a given form, and of knots in all their tables.
MOST_SHAPES, MOST_KNOTS = _KERNEL["PMF_MAX_SHAPES"], _KERNEL["PMF_MAX_KNOTS"]


@dataclass(frozen=True)
class ShapeTable:
    """The form of a force, as a table of a speed or a place, or as a function without a table.

    The knots (k,) are evenly spaced: the first is at `start`, and `step` separates them. The last value continues
    beyond them. The form "square" is the square of the speed. The form "wave" is sin(2 pi (place - start) / step).
    The coefficient of a `positive` form is never negative.
    """

    of: Literal["speed", "square", "place", "wave"]
    knots: tuple[float, ...] = (0.0, 1.0)
    start: float = 0.0
    step: float = 1.0
    positive: bool = False


#: A form, and whether its force acts against the motion.
Acting = tuple[ShapeTable, bool]


def shape_values(
    shapes: Sequence[Acting], nodes: Sequence[int], measured: Sequence[int] | None = None
) -> dict[str, object]:
    """Return the fields of `pmf_shapes_config_t`.

    `nodes` lists the node of each form's mean over an interval. `measured` lists the nodes of their values at the
    measured position, with 0 for none. Raises ValueError if the kernel has no room for the tables.
    """
    rows, knots, sums = [], [0.0], [0.0]  # an array in C has at least one element
    for (table, resists), node, seen in zip(shapes, nodes, measured or [0] * len(nodes), strict=True):
        own = np.array(table.knots)
        form = (_OF[table.of], int(resists), int(table.positive))
        rows.append((*form, len(knots), own.size - 1, node, seen, table.start, 1 / table.step))
        knots += own.tolist()
        sums += [0.0, *np.cumsum((own[1:] + own[:-1]) / 2).tolist()]
    if refused := too_many([table for table, _ in shapes]):
        raise ValueError(refused)
    return {"n": len(rows), "shape": rows, "knot": knots, "sum": sums}


def too_many(tables: Sequence[ShapeTable]) -> str:
    """Return why the kernel has no room for the tables, with a remedy. The text is empty if it has room."""
    knots = 1 + sum(len(table.knots) for table in tables)
    if len(tables) <= MOST_SHAPES and knots <= MOST_KNOTS:
        return ""
    return (
        f"the model has {len(tables)} forces of a given form, with {knots} values in their tables, and the kernel "
        f"holds at most {MOST_SHAPES} forces and {MOST_KNOTS} values; use fewer terms such as cogging or gravity"
    )


#: exp(-t / lag) over a part of a sample: its end value, its integral, and the integral of t exp(-t / lag), t in
#: samples.
Decay = tuple[float, float, float]


def late_values(dt: float, dead_time: float, lag: float, precision: str = "float64") -> dict[str, object]:
    """Return the fields of `pmf_late_config_t` for a dead time and a lag [s], not both 0."""
    real = np.float32 if precision == "float32" else np.float64
    samples = float(real(dead_time) * real(1 / dt))
    whole, part = math.floor(samples), samples - math.floor(samples)
    return {
        "kept": whole + 2,
        "part": part,
        "lags": int(lag > 0),
        "decay": decays(part, lag / dt) if lag > 0 else [(0.0, 0.0, 0.0)] * 2,
    }


def decays(part: float, lag: float) -> list[Decay]:
    """Return the decays of a lag > 0 [samples] over `part` of a sample and over its remainder."""
    return [_decay(part, lag), _decay(1 - part, lag)]


def _decay(time: float, lag: float) -> Decay:
    rest, gone = exp(-time / lag), -expm1(-time / lag)
    return rest, lag * gone, lag * (lag * gone - time * rest)
