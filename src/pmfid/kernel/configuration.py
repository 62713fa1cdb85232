"""The kernel's configuration as one structure, filled by name: every field must be given, none can be forgotten."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from pmfid.kernel.structures import Structured, constants_of, structures

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Values of a structure by the names of its fields; of an array the first ones, the others are 0.
Values = Mapping[str, object]
Stages = Sequence[tuple[int, float, float, float]]
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
) -> Kernel:
    """A kernel in its initial state.

    stages: rows (source, a, b0, b1); columns: per column a list of (node, weight); encoder, direct, instrument,
    auxiliary, linear, late: the fields of the C structures by name; without auxiliary and linear there is no model that
    is simulated, and no `instrument`; without late the input acts at once; shapes: the field of this name of
    `auxiliary`, where there is none. first_samples: settle_samples where not given. Raises ValueError where a size is
    exceeded, a field is missing or unknown, or the kernel finds the numbers impossible.
    """
    from pmfid import _kernel32, _kernel64

    parameters = max(cast("int", one["n_parameters"]) for one in (direct, instrument or direct))
    config = np.zeros((), structures(None, precision)["pmf_config_t"])
    values = {
        "settle_samples": settle_samples,
        "first_samples": settle_samples if first_samples is None else first_samples,
        "encoder": encoder,
        "network": network_values(stages, columns, parameters),
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


def network_values(stages: Stages, columns: Columns, parameters: int) -> dict[str, object]:
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
    return {
        "n_stages": len(stages),
        "n_columns": len(columns),
        "stage": list(stages),
        "tap_end": np.cumsum([len(column) for column in columns]),
        "tap": taps,
    }


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
