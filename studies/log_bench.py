"""A rotary and a linear axis with known truth, and functions that write their logs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pmfid.simulation.drive import DriveParameters, quantize, simulate_drive
from pmfid.simulation.signals import prbs
from tests.formats import WRITERS

Columns = dict[str, np.ndarray]
Keys = dict[str, dict[str, object]]
DEG = math.pi / 180


@dataclass(frozen=True, eq=False)
class Bench:
    """An axis: the truth in SI, dt [s], the step of its encoder [m or rad], and u and y of the clean log."""

    name: str
    truth: DriveParameters
    dt: float
    step: float
    u: np.ndarray
    y: np.ndarray

    @property
    def t(self) -> np.ndarray:
        return np.arange(self.u.size) * self.dt

    @property
    def counts(self) -> np.ndarray:
        return np.asarray(np.rint(self.y / self.step), np.int64)


def _bench(name: str, truth: DriveParameters, dt: float, step: float, amplitude: float, clock: int) -> Bench:
    u = np.round(prbs(4000, clock=clock, amplitude=amplitude, rng=np.random.default_rng(41)), 6)
    y = simulate_drive(truth, u, dt).x
    return Bench(name, truth, dt, step, u, quantize(y, step) * step)


#: A motor with 3600 counts in a turn, driven by its current, and a linear axis with a scale of 10 um.
BENCHES = {
    "rotary": _bench("rotary", DriveParameters(3.2e-4, 1.2e-3, 0.025, 0.35), 1e-3, 0.1 * DEG, 0.6, 40),
    "linear": _bench("linear", DriveParameters(37.0, 80.0, 12.0, 30.0), 4e-3, 1e-5, 3.0, 25),
}


Writer = Callable[[Path, Bench], Path]


@dataclass(frozen=True, eq=False)
class Log:
    """A variant of a log: the file from a bench's columns t, u, y, and the keys of AXIS.toml of a typical user.

    The user knows the names of the columns and the numbers on the data sheet, but not this program. `units` are the
    units of the user's numbers, and decide between two remedies. `mend` applies a remedy in words to the file.
    """

    name: str
    bench: str
    write: Writer
    keys: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    units: tuple[str, ...] = ()
    mend: Callable[[Path], None] | None = None

    def config(self) -> Keys:
        bench = BENCHES[self.bench]
        keys: Keys = {
            "record": {"input": "u", "output": "y", "time": "t"},
            "encoder": {"resolution": bench.step},
            "model": {"input_gain": bench.truth.input_gain},
            "estimator": {"method": "iv", "cutoff": 0.1 / bench.dt},
        }
        for section, changes in self.keys.items():
            keys[section] |= changes
        keys["record"] = {key: value for key, value in keys["record"].items() if value is not None}
        return keys


def columns(bench: Bench) -> Columns:
    return {"t": bench.t, "u": bench.u, "y": bench.y}


def text(table: Mapping[str, object], separator: str = ",", decimal: str = ".", header: str | None = None) -> str:
    """Return lines of text; numbers have nine digits, text is unchanged."""
    rows = [
        [value if isinstance(value, str) else f"{value:.9g}".replace(".", decimal) for value in row]
        for row in zip(*(list(column) for column in table.values()), strict=True)  # type: ignore[call-overload]
    ]
    first = separator.join(table) if header is None else header
    return "\n".join([*([first] if first else []), *(separator.join(row) for row in rows)]) + "\n"


def as_text(
    change: Callable[[Bench], Mapping[str, object]] = columns,
    edit: Callable[[str], str | bytes] = lambda whole: whole,
    name: str = "run.csv",
    layout: Mapping[str, str] = MappingProxyType({}),
) -> Writer:
    """Return a writer of changed columns as text, which `edit` changes as a whole."""

    def write(folder: Path, bench: Bench) -> Path:
        whole = edit(text(change(bench), **layout))
        (folder / name).write_bytes(whole if isinstance(whole, bytes) else whole.encode())
        return folder / name

    return write


def as_file(suffix: str, change: Callable[[Bench], Mapping[str, object]] = columns) -> Writer:
    def write(folder: Path, bench: Bench) -> Path:
        WRITERS[suffix](folder / f"run{suffix}", change(bench))
        return folder / f"run{suffix}"

    return write


def renamed(**changes: tuple[str, float]) -> Callable[[Bench], Columns]:
    """Return a change of the columns' names and units, such as y = ("pos_mm", 1e-3)."""

    def change(bench: Bench) -> Columns:
        own = columns(bench)
        pairs = {key: changes.get(key, (key, 1.0)) for key in own}
        return {name: own[key] / factor for key, (name, factor) in pairs.items()}

    return change


def replaced(**changes: Callable[[Bench], object]) -> Callable[[Bench], Mapping[str, object]]:
    """Return a change that computes columns again."""
    return lambda bench: columns(bench) | {key: make(bench) for key, make in changes.items()}
