"""Random configurations and records, each of valid and broken parts; the same seed draws the same case."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import scipy.io
import scipy.sparse

from pmfid.estimators import METHODS
from pmfid.models.equation import DERIVATIVES
from pmfid.simulation.control import position_control
from pmfid.simulation.drive import DriveParameters, quantize, simulate_drive
from pmfid.simulation.process import simulate_process
from pmfid.simulation.signals import multisine, prbs, trapezoid

Rng = np.random.Generator
Columns = dict[str, Any]

#: Part of the keys that get a broken value, of the records that get a defect, and of the keys that are left out.
BROKEN, DEFECT, LEFT_OUT = 0.012, 0.35, 0.006


@dataclass(frozen=True)
class Case:
    """What one call gets: the command with its options, the text of AXIS.toml, the name and the bytes of the record."""

    command: tuple[str, ...]
    axis: str
    name: str
    record: bytes


def draw(seed: int, folder: Path) -> Case:
    """The case of a number; folder: for files that are written on the way."""
    rng = np.random.default_rng([20, seed])
    plant = str(rng.choice(list(PLANTS), p=[0.3, 0.15, 0.15, 0.1, 0.3]))
    columns, facts = PLANTS[plant](int(rng.integers(4)))
    kind = "transfer_function" if plant == "process" else str(rng.choice(["drive", "equation"], p=[0.75, 0.25]))
    axis = _axis(rng, kind, dict(facts))
    columns = dict(columns)
    while rng.random() < DEFECT:
        columns = rng.choice(DEFECTS)(rng, columns)  # type: ignore[arg-type]
    name, data = _file(rng, columns, folder)
    return Case(_command(rng, kind), axis, name, data)


# --- plants -----------------------------------------------------------------------------------------------------------


def _cart(seed: int) -> tuple[Columns, Columns]:
    rng, dt, resolution = np.random.default_rng(seed), 0.01, 2e-4
    u = prbs(500, clock=10, amplitude=3.0, rng=rng)
    run = simulate_drive(DriveParameters(1.07, 12.8, 0.8, 2.0), u, dt)
    return _logged(u, run.x, resolution, dt, input_gain=2.0, cutoff=30.0)


def _heavy(seed: int) -> tuple[Columns, Columns]:
    dt, resolution = 0.004, 1e-5 * 4**seed
    reference = np.concatenate([trapezoid(200, dt, 0.1, 0.6), 0.1 + trapezoid(200, dt, -0.1, 0.6)] * 2)
    plant = DriveParameters(60.0, 90.0, 20.0, 1.0, offset=5.0)
    run, _ = position_control(plant, reference, dt, kp=3e4, kd=2e3, u_max=600.0, resolution=resolution)
    return _logged(run.u, run.x, resolution, dt, input_gain=1.0, cutoff=50.0)


def _rotary(seed: int) -> tuple[Columns, Columns]:
    dt, resolution = 0.001, 2 * np.pi / 2000
    u = multisine(900, dt, [1.3, 4.1, 7.7], 2.0, np.random.default_rng(seed))
    run = simulate_drive(DriveParameters(3e-4, 1e-3, 5e-3, 0.05), u, dt)
    return _logged(u, run.x, resolution, dt, input_gain=0.05, cutoff=100.0)


def _rest(seed: int) -> tuple[Columns, Columns]:
    u = [np.zeros(300), np.ones(300), np.linspace(0, 1, 300), np.sin(np.arange(300.0))][seed]
    return _logged(u, 1e-5 * u if seed else u, 1e-4, 0.01, input_gain=1.0, cutoff=20.0)


def _process(seed: int) -> tuple[Columns, Columns]:
    rng, dt = np.random.default_rng(seed), 0.05
    u = prbs(400, clock=8, amplitude=1.0, rng=rng)
    y = simulate_process((2.0,), (1.0, 1.2, 4.0), u, dt) + 0.02 * rng.standard_normal(u.size)
    columns, facts = _logged(u, y, 1e-3, dt, cutoff=3.0)
    return columns | {"r": u}, facts


PLANTS: dict[str, Callable[[int], tuple[Columns, Columns]]] = {
    name: cache(make)
    for name, make in {
        "cart": _cart,
        "heavy": _heavy,
        "rotary": _rotary,
        "rest": _rest,
        "process": _process,
    }.items()
}


def _logged(u: np.ndarray, y: np.ndarray, resolution: float, dt: float, **facts: float) -> tuple[Columns, Columns]:
    columns = {"t": dt * np.arange(u.size), "u": u, "y": y, "counts": quantize(y, resolution)}
    return columns, {"dt": dt, "resolution": resolution, **facts}


# --- configurations ---------------------------------------------------------------------------------------------------

#: In place of any value.
WRONG: list[Any] = [0, -1, 1e308, 1e-320, -1e-300, 1e30, 1e-30, 10**30, "", "x", "\u001b[31m", True, [], [1], {"a": 1}]
WRONG += [float("nan"), float("inf"), 2**63, 3.7, "[red]", "µm"]


def _axis(rng: Rng, kind: str, facts: Columns) -> str:
    counted, process = bool(rng.random() < 0.6), kind == "transfer_function"
    record = {
        "input": "u",
        "output": "counts" if counted else "y",
        "output_kind": "counts" if counted else "position",
        **_clock(rng, facts["dt"]),
        **_some(rng, 0.1, input_scale=[1.0, -2.0, 0.001, 1e9, "gain"]),
        **_some(rng, 0.25 if process else 0.01, gap=[0.5], hold=["foh"], reference=["r", "u"]),
    }
    encoder = {
        "resolution": facts["resolution"],
        **_some(rng, 0.1, bits=[8, 16, 32, 1]),
        **_some(rng, 0.02 if process else 0.15, standstill_time=[0.01, 5.0, 1e9], max_speed=[1e-6, 1.0, 1e12]),
    }
    model = {"kind": kind, **_MODELS[kind](rng, facts)}
    estimator = {
        "cutoff": facts["cutoff"] * float(rng.choice([1.0, 0.2, 3.0, 0.01, 100.0], p=[0.7, 0.15, 0.1, 0.03, 0.02])),
        **_some(rng, 0.5, method=list(METHODS)),
        **_some(rng, 0.2, order=[2, 3, 6], forgetting=[0.99, 0.5, 1.0, 1e-3, 0.999999]),
        **_some(rng, 0.1, forgetting_scheme=["exponential", "directional", "constant-trace", "window"]),
        **_some(rng, 0.15, precision=["float32", "float64"], discretization=["matched", "paper", "exact"]),
        **_some(rng, 0.05, prefilter_zeros=[[-3.0, -1.0], [-1e-6, -1e6], [-5.0, -4.0]]),
    }
    sections = {"record": record, "encoder": encoder, "model": model, "estimator": estimator}
    for section in sections.values():
        for key in list(section):
            if rng.random() < BROKEN:
                section[key] = WRONG[rng.integers(len(WRONG))]
            if rng.random() < LEFT_OUT:
                del section[key]
    text = "".join(f"[{name}]\n" + "".join(f"{k} = {_toml(v)}\n" for k, v in s.items()) for name, s in sections.items())
    if rng.random() < 0.02:
        text = text[: rng.integers(len(text))] + str(rng.choice(["\0", "[", "= =", "\n[record]\n", "é"]))
    return text


def _clock(rng: Rng, dt: float) -> Columns:
    choices: list[Columns] = [{"time": "t"}, {"dt": dt}, {"time": "t", "dt": dt}, {"time": "t", "time_unit": "ms"}]
    return choices[rng.choice(4, p=[0.6, 0.25, 0.1, 0.05])]


def _some(rng: Rng, chance: float, **choices: list[Any]) -> Columns:
    """Each key with a chance, and one of its values."""
    return {key: values[rng.integers(len(values))] for key, values in choices.items() if rng.random() < chance}


def _drive(rng: Rng, facts: Columns) -> Columns:
    gain = facts["input_gain"] * float(rng.choice([1.0, -1.0, 1e-6, 1e6], p=[0.85, 0.09, 0.03, 0.03]))
    extra = _some(rng, 0.2, offset=[True, False], spring=[True], friction=["directional", "symmetric"])
    return {"input_gain": gain, **extra}


def _equation(rng: Rng, facts: Columns) -> Columns:
    signals = ["output", "direction", "moving", "forward", "backward", "forward_output", "backward_output", "input"]
    terms = [{"signal": "output", "derivative": 2, "name": "m"}, {"signal": "output", "derivative": 1, "name": "d"}]
    terms += [{"signal": "direction", "name": "c", "unit": str(rng.choice(["N", "[b]", "$\\frac$", "µ*/"]))}]
    if rng.random() < 0.5:
        signal = str(rng.choice(signals))
        low, high = DERIVATIVES.get(signal, (0, 0))  # type: ignore[call-overload]
        derivative = int(rng.integers(low, high + 2 if rng.random() < 0.1 else high + 1))
        terms.append({"signal": signal, "derivative": derivative, "name": f"p{derivative}"})
    kept = [term for term in terms if rng.random() > 0.15]
    known: list[Columns] = [{"signal": "input", "coefficient": facts["input_gain"]}]
    if rng.random() < 0.15:
        known.append({"signal": "output", "derivative": int(rng.choice([0, 2])), "coefficient": -1.0})
    return {"unknown": kept, "known": known}


def _transfer_function(rng: Rng, facts: Columns) -> Columns:
    n = int(rng.choice([1, 2, 3, 6, 7], p=[0.3, 0.45, 0.15, 0.08, 0.02]))
    m = int(rng.integers(0, n + 1 if rng.random() < 0.05 else n))
    return {"n": n, "m": m, **_some(rng, 0.2, delay=[0, 1, 20], offset=[True])}


_MODELS = {"drive": _drive, "equation": _equation, "transfer_function": _transfer_function}


def _toml(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=True)


# --- records ----------------------------------------------------------------------------------------------------------


def _numbers(values: Any) -> np.ndarray:
    """A column as floats; zeros where it has become text."""
    array = np.asarray(values)
    return array.astype(float) if array.dtype.kind in "biuf" else np.zeros(array.size)


def _spoilt(rng: Rng, columns: Columns) -> Columns:
    """Some values of a column that nobody expects there."""
    name = str(rng.choice(list(columns)))
    values = _numbers(columns[name]).copy()
    bad = rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 1e-320, 2.0**63, 1e18, 0.5])
    values[rng.integers(values.size, size=int(rng.choice([1, 3, values.size])))] = bad
    return columns | {name: values}


def _scaled(rng: Rng, columns: Columns) -> Columns:
    name = str(rng.choice(list(columns)))
    factor = float(rng.choice([0.0, -1.0, 1e3, 1e6, 1e9, 1e-9, 1e-200, 1e200, 1e120]))
    return columns | {name: _numbers(columns[name]) * factor}


def _exchanged(rng: Rng, columns: Columns) -> Columns:
    one, other = rng.choice(list(columns), 2, replace=False)
    return columns | {str(one): columns[other], str(other): columns[one]}


def _without(rng: Rng, columns: Columns) -> Columns:
    gone = str(rng.choice(list(columns)))
    return {name: values for name, values in columns.items() if name != gone}


def _renamed(rng: Rng, columns: Columns) -> Columns:
    old = str(rng.choice(list(columns)))
    new = str(rng.choice(["T", " u", "y [mm]", "t_ms", "time [s]", "\x1b[31mred", "größe", "[bold]u", "a\x07b", "1"]))
    return {new if name == old else name: values for name, values in columns.items()}


def _cut(rng: Rng, columns: Columns) -> Columns:
    """Rows left out, repeated, in another order, or all but a few gone."""
    n = len(next(iter(columns.values())))
    rows = np.arange(n)
    way = rng.integers(6)
    if way == 0:
        rows = rows[: rng.integers(0, 30)]
    elif way == 1:
        rows = np.delete(rows, rng.integers(n, size=max(1, n // 100)))
    elif way == 2:
        rows = np.sort(np.r_[rows, rng.integers(n, size=3)])
    elif way == 3:
        rows = rows[::-1]
    elif way == 4:
        rows = np.delete(rows, slice(n // 2, n // 2 + 50))
    else:
        rows = rows[:: int(rng.integers(2, 40))]
    return {name: np.asarray(values)[rows] for name, values in columns.items()}


def _wrapped(rng: Rng, columns: Columns) -> Columns:
    if "counts" not in columns:
        return columns
    with np.errstate(invalid="ignore"):
        counts = np.nan_to_num(_numbers(columns["counts"]), posinf=0, neginf=0) % 2.0 ** int(rng.choice([4, 8, 10]))
    return columns | {"counts": counts}


def _jittered(rng: Rng, columns: Columns) -> Columns:
    if "t" not in columns:
        return columns
    t = _numbers(columns["t"])
    return columns | {"t": t + rng.normal(size=t.size) * float(rng.choice([1e-5, 1e-3, 1e-2]))}


def _typed(rng: Rng, columns: Columns) -> Columns:
    name = str(rng.choice(list(columns)))
    values = np.asarray(columns[name])
    ways: list[Callable[[], Any]] = [
        lambda: [f"{value:.6g} V" for value in values.tolist()],
        lambda: [str(value).replace(".", ",") for value in values.tolist()],
        lambda: _numbers(values) > 0.1,
        lambda: ["" for _ in values],
        lambda: [f" {value!r} " for value in values.tolist()],
    ]
    return columns | {name: ways[rng.integers(len(ways))]()}


DEFECTS: list[Callable[[Rng, Columns], Columns]] = [
    _spoilt,
    _scaled,
    _exchanged,
    _without,
    _renamed,
    _cut,
    _wrapped,
    _jittered,
    _typed,
]


def _file(rng: Rng, columns: Columns, folder: Path) -> tuple[str, bytes]:
    """A record as a file: name and bytes, of which some may be missing or wrong."""
    kind = str(rng.choice(["csv", "parquet", "mat"], p=[0.7, 0.15, 0.15]))
    frame = pl.DataFrame({name: pl.Series(values, strict=False) for name, values in columns.items()})
    if kind == "csv":
        data = frame.write_csv().encode(str(rng.choice(["utf-8", "utf-8-sig", "utf-16"], p=[0.9, 0.07, 0.03])))
    elif kind == "parquet":
        frame.write_parquet(folder / "drawn.parquet")
        data = (folder / "drawn.parquet").read_bytes()
    else:
        data = _mat(rng, columns, folder)
    if rng.random() < 0.08:
        data = _damaged(rng, data)
    name = str(rng.choice(["run", "a b", "run[red]", "größe", "esc\x1b[31m"], p=[0.9, 0.03, 0.03, 0.02, 0.02]))
    return f"{name}.{kind}", data


def _mat(rng: Rng, columns: Columns, folder: Path) -> bytes:
    named = {name: np.asarray(values) for name, values in columns.items() if name.isidentifier() and name.isascii()}
    named |= {"gain": np.float64(rng.choice([2.0, 0.0, np.nan, -1.0]))}
    if rng.random() < 0.1 and named:
        name = str(rng.choice(list(named)))
        odd: list[Any] = [np.ones((3, 4)), np.array(1j), scipy.sparse.eye(5).tocsc(), np.array([], float), {"a": 1.0}]
        named[name] = odd[rng.integers(len(odd))]
    scipy.io.savemat(folder / "drawn.mat", named)
    return (folder / "drawn.mat").read_bytes()


def _damaged(rng: Rng, data: bytes) -> bytes:
    way = rng.integers(4)
    if way == 0 or not data:
        return b""
    if way == 1:
        return data[: rng.integers(len(data))]
    if way == 2:
        return data.replace(b",", b";")
    spot = int(rng.integers(len(data)))
    return data[:spot] + bytes(rng.integers(0, 256, 4, dtype=np.uint8)) + data[spot + 4 :]


# --- commands ---------------------------------------------------------------------------------------------------------


def _command(rng: Rng, kind: str) -> tuple[str, ...]:
    """The command before, and its options behind, the record and the configuration."""
    command = str(rng.choice(["identify", "compare", "order", "export"], p=[0.85, 0.02, 0.01, 0.12]))
    options = ["--json"] if command != "export" and rng.random() < 0.6 else []
    if command == "identify":
        options += _options(
            rng, 0.1, **{"--method": list(METHODS), "--cutoff": ["10", "-1", "1e9"], "--quantize": ["1e-3"]}
        )
        options += _options(
            rng, 0.03, **{"--resolution": ["1e-3", "0"], "--forgetting": ["0.9"], "--order": ["4", "9"]}
        )
        options += _options(rng, 0.05, **{"--out": ["out"]})
    if command == "compare":
        options += _options(rng, 0.1, **{"--quantize": ["1e-3", "nan"]})
    if command == "export":
        options += ["--out", "out", *_options(rng, 0.3, **{"--precision": ["float32"], "--method": list(METHODS)})]
    return (command, *options)


def _options(rng: Rng, chance: float, **choices: list[str]) -> list[str]:
    return [text for key, value in _some(rng, chance, **choices).items() for text in (key, value)]
