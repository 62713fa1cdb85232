"""The kernel's configuration, filled by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from pmfid.kernel.structures import Structured, constants_of, structures

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Values of a structure by the names of its fields; of an array the first ones, the others are 0.
Values = Mapping[str, object]
Stages = Sequence[tuple[int, float, float, float]]
#: Coefficients that grow with the step, those of a derivative, and those by the mean square of the step as well.
Kind = Literal["lasting", "changing", "bending"]
#: How a stage follows a step that varies: 1 if its signals are those of the interval before; kind; pole times half a
#: sample period.
Rate = tuple[int, Kind, float]
#: For each stage the number of its rate from 1 on, 0: none; and the rates.
Rates = tuple[Sequence[int], Sequence[Rate]]
Columns = Sequence[Sequence[tuple[int, float]]]


def new_kernel(
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
    linear: Values | None = None,
    late: Values | None = None,
    shapes: Values | None = None,
    rates: Rates = ((), ()),
) -> Kernel:
    """A kernel in its initial state.

    stages: rows (source, a, b0, b1); columns: per column a list of (node, weight); encoder, direct, instrument,
    auxiliary, linear, late: the fields of the C structures by name; without auxiliary and linear there is no model that
    is simulated, and no `instrument`; without late the input acts at once; shapes: the field of this name of
    `auxiliary`, where there is none. first_samples: settle_samples where not given; rates: of a clock that is not even.
    Raises ValueError if a size is
    exceeded, a field is missing or unknown, or the kernel finds the numbers impossible.
    """
    from pmfid import _kernel32, _kernel64

    parameters = max(cast("int", one["n_parameters"]) for one in (direct, instrument or direct))
    config = np.zeros((), structures(None, precision)["pmf_config_t"])
    values = {
        "settle_samples": settle_samples,
        "first_samples": settle_samples if first_samples is None else first_samples,
        "encoder": encoder,
        "network": network_values(stages, columns, parameters, rates),
        "direct": direct,
        "auxiliary": auxiliary,
        "linear": linear,
        "late": late,
        "instrument": instrument,
    }
    fill(config, values)
    if shapes is not None and auxiliary is None:
        fill(config["auxiliary"]["shapes"], shapes)
    module = _kernel32 if precision == "float32" else _kernel64  # typed alike
    return cast("Kernel", module.Kernel(config.tobytes()))


def network_values(stages: Stages, columns: Columns, parameters: int, rates: Rates = ((), ())) -> dict[str, object]:
    """The fields of `pmf_network_config_t`. Raises ValueError if the kernel has no room for the stages or columns."""
    sizes, taps = constants_of(None), [tap for column in columns for tap in column]
    names = ("PMF_MAX_STAGES", "PMF_MAX_TAPS", "PMF_MAX_COLUMNS", "PMF_MAX_PARAMETERS")
    room = [sizes[name] for name in names]
    if any(
        number > most for number, most in zip((len(stages), len(taps), len(columns), parameters), room, strict=True)
    ):
        raise ValueError(
            f"the equation needs {len(stages)} stages, {len(taps)} taps and {parameters} parameters; the kernel holds "
            f"{room[0]}, {room[1]} and {room[3]}; use a lower order"
        )
    if len(rates[1]) >= sizes["PMF_MAX_RATES"]:
        raise ValueError(
            f"the stages follow a step in {len(rates[1])} ways, the kernel holds {sizes['PMF_MAX_RATES'] - 1}; "
            "give fewer prefilter_zeros"
        )
    return {
        "n_stages": len(stages),
        "n_columns": len(columns),
        "stage": [(*stage, rate) for stage, rate in zip(stages, rates[0] or [0] * len(stages), strict=True)],
        "tap_end": np.cumsum([len(column) for column in columns]),
        "tap": taps,
        "n_rates": len(rates[1]) + 1 if rates[1] else 0,
        "rates": _rate_values(rates[1]),
    }


def _rate_values(rates: Sequence[Rate]) -> dict[str, object]:
    """The fields of `pmf_rates_t`."""
    rows: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)] if rates else []
    kinds: tuple[Kind, ...] = ("changing", "lasting", "bending")  # as gain, growth and square
    for late, kind, half in rates:
        rows.append((1.0 - late, float(late), half, 1.0, *((1 + half) * (kind == one) for one in kinds)))
    names = ("now", "before", "half", "keep", "gain", "growth", "square")
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def fill(structure: Structured, values: Values) -> None:
    """Gives every field of a structure (0-d) its value; None: a part that is not there, all zeros.

    Raises ValueError for a field that has no value, a value that has no field, and more values than an array holds.
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
    if field.dtype.names:  # tuples, one for each row
        rows = cast("Sequence[tuple[float, ...]]", value)
        shape: tuple[int, ...] = (len(rows),)
    else:
        rows = np.asarray(value, field.dtype)
        shape = rows.shape
    if len(shape) != field.ndim or any(size > most for size, most in zip(shape, field.shape, strict=True)):
        raise ValueError(f"{name} has the shape {shape}, the kernel holds {field.shape}")
    if all(shape):
        field[tuple(slice(size) for size in shape)] = rows


_KERNEL = constants_of(None)
_OF = {name: _KERNEL[f"PMF_OF_{name.upper()}"] for name in ("speed", "square", "place", "wave")}
#: Forces that it holds, and knots of all their tables.
MOST_SHAPES, MOST_KNOTS = _KERNEL["PMF_MAX_SHAPES"], _KERNEL["PMF_MAX_KNOTS"]
FIRST_NODE = _KERNEL["PMF_SIGNALS"]


@dataclass(frozen=True)
class ShapeTable:
    """knots (k,) from `start` on in steps, of a speed or a place; beyond them the last one holds. Without knots:
    "square" of the speed, and "wave": sin(2 pi (place - start) / step). positive: as of the `Shape`."""

    of: Literal["speed", "square", "place", "wave"]
    knots: tuple[float, ...] = (0.0, 1.0)
    start: float = 0.0
    step: float = 1.0
    positive: bool = False


#: A table, and whether the force acts against the motion.
Acting = tuple[ShapeTable, bool]


def shape_values(
    shapes: Sequence[Acting], nodes: Sequence[int], measured: Sequence[int] | None = None
) -> dict[str, object]:
    """The fields of `pmf_shapes_config_t`; nodes: where the mean of each over an interval goes; measured: and where its
    value at the place of the counts, 0: nowhere. Raises ValueError if the kernel has no room for the tables."""
    rows, knots, sums = [], [0.0], [0.0]  # never none, for an array of C has one element or more
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
    """Why the kernel cannot hold them, with a remedy; empty if it can."""
    knots = 1 + sum(len(table.knots) for table in tables)
    if len(tables) <= MOST_SHAPES and knots <= MOST_KNOTS:
        return ""
    return (
        f"the model has {len(tables)} forces of a given form with {knots} knots, the kernel holds {MOST_SHAPES} and "
        f"{MOST_KNOTS}; use fewer"
    )


@lru_cache
def shape_bytes(shapes: tuple[Acting, ...]) -> bytes:
    """The same for the simulation alone (`_kernel64.simulate`); empty without any."""
    if not shapes:
        return b""
    config = np.zeros((), structures(None, "float64")["pmf_shapes_config_t"])
    fill(config, shape_values(shapes, range(FIRST_NODE, FIRST_NODE + len(shapes))))
    return config.tobytes()


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
