"""What watching so many axes costs, on paper: cores, memory, network, storage, and when to take the next larger way.

Every number comes from a measurement (`cost.json`, written by `python -m studies.cost`); the sums are linear, as the
measurements are.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pmfid.errors import UsageError, whole_number

__all__ = ["HEADER", "WAYS", "Bill", "Constant", "Load", "Machine", "advice", "bill", "constants", "most_axes", "row"]

#: Ways to do the work, from the smallest on; the last two have stored data, not samples as they come.
WAYS = ("process", "serve", "spark stream", "history", "spark history")
#: What a way may take of a core, on average: the rest is for bursts, and for catching up behind a restart.
USED = 0.7
#: Fewer samples in a call are computed axis by axis, not side by side.
FEW = 8
DAY = 86400.0
#: Axes of any load.
MOST = 2**40


@dataclass(frozen=True)
class Constant:
    """value: in SI units; what: in words; page: where it was measured."""

    value: float
    unit: str
    what: str
    page: str


@cache
def constants() -> Mapping[str, Constant]:
    """All that is measured, by name."""
    raw = json.loads((Path(__file__).parent / "cost.json").read_text(encoding="utf-8"))
    return {name: Constant(**one) for name, one in raw.items()}


def _number(name: str, value: object, remedy: str, most: int) -> int:
    """A whole number from 1 to `most`."""
    number = whole_number(name, value, 1, remedy)
    if number > most:
        raise UsageError(f"{name} must be at most {most}, got {number:.3g}; {remedy}")
    return number


@dataclass(frozen=True)
class Load:
    """axes: number, >= 1; rate: samples of each per second [Hz], > 0; block: time between two calls or messages of an
    axis [s], > 0. Raises UsageError for others."""

    axes: int
    rate: float
    block: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", _number("axes", self.axes, "it is the number of axes watched", MOST))
        for name, unit in (("rate", "Hz"), ("block", "s")):
            value = getattr(self, name)
            if not (1e-9 <= value <= 1e9):
                raise UsageError(f"{name} must be a number above 0 [{unit}], at most 1e9, got {value!r}")

    @property
    def samples(self) -> float:
        """Of an axis in a block, at least 1."""
        return max(1.0, self.rate * self.block)

    @property
    def blocks(self) -> float:
        """Of an axis per second."""
        return self.rate / self.samples


@dataclass(frozen=True)
class Machine:
    """cores: number, >= 1; memory [bytes]. Raises UsageError for others."""

    cores: int = 8
    memory: float = 32e9

    def __post_init__(self) -> None:
        _number("cores", self.cores, "it is the number of a machine's processors", 10**6)
        if not (1e9 <= self.memory <= 1e15):
            raise UsageError(f"memory must be from 1 to 1e6 [GB], got {self.memory / 1e9:g}")


@dataclass(frozen=True)
class Bill:
    """What a way costs. cores: busy on average; memory [bytes]; network: that comes in [bytes/s]; storage [bytes] of
    checkpoints, of a history for each day of samples; checkpoint, restart: time [s], None: not of this way, or not
    measured; processes, machines: so many."""

    way: str
    cores: float
    memory: float
    network: float
    storage: float
    checkpoint: float | None
    restart: float | None
    processes: int
    machines: int


def bill(way: str, load: Load, machine: Machine = Machine()) -> Bill:
    """What one of `WAYS` costs under a load on such machines. Raises UsageError for another way."""
    if way not in WAYS:
        raise UsageError(f"way must be one of {list(WAYS)}, got {way!r}")
    of = {"process": _process, "serve": _serve, "spark stream": _spark_stream}.get(way, _history)
    return of(way, load, machine)


def _value(name: str) -> float:
    return constants()[name].value


def _message(load: Load) -> float:
    """Bytes per second of all blocks on the wire."""
    return load.axes * load.blocks * (_value("block_bytes") + load.samples * _value("sample_bytes"))


def _machines(cores: float, memory: float, machine: Machine) -> int:
    return max(1, math.ceil(cores / (USED * machine.cores)), math.ceil(memory / (USED * machine.memory)))


def _process(way: str, load: Load, machine: Machine) -> Bill:
    few = "few_" if load.samples < FEW else ""
    each = _value(f"{few}call") + load.samples * _value(f"{few}sample")
    cores, state = load.axes * load.blocks * each, load.axes * _value("state")
    memory = _value("base") + state + load.axes * (_value("result") + load.samples * _value("sample_bytes"))
    machines = _machines(cores, memory, machine)
    return Bill(
        way, cores, memory, _message(load), 2 * state, state / machines / _value("checkpoint_rate"),
        load.axes / machines * _value("restore_axis"), machines, machines,
    )  # fmt: skip


def _serve(way: str, load: Load, machine: Machine) -> Bill:
    """One thread of a process estimates, so a process has a core; several share a machine's axes out. A block of fewer
    samples than those of the measurement is taken to cost as much."""
    cores = load.axes * load.blocks * _value("serve_block") * max(1.0, load.samples / _value("serve_samples"))
    state, own = load.axes * _value("serve_state"), load.axes * _value("serve_memory")
    processes = max(1, math.ceil(cores / USED))
    memory = processes * _value("serve_base") + own
    machines = max(math.ceil(processes / machine.cores), _machines(0.0, memory, machine))
    return Bill(
        way, cores, memory, _message(load), 2 * state, state / processes / _value("checkpoint_rate"), None,
        processes, machines,
    )  # fmt: skip


def _spark_stream(way: str, load: Load, machine: Machine) -> Bill:
    cores, state = load.axes * load.rate * _value("stream_sample"), load.axes * _value("serve_state")
    own = load.axes * _value("serve_memory")
    machines = _machines(cores, own, machine)
    memory = machines * _value("spark_base") + own
    machines = max(machines, _machines(cores, memory, machine))
    return Bill(way, cores, memory, _message(load), 2 * state, None, None, machines, machines)


def _history(way: str, load: Load, machine: Machine) -> Bill:
    """A day of samples, estimated once."""
    spark = way == "spark history"
    cores = load.axes * load.rate * _value("spark_history_sample" if spark else "history_sample")
    machines = _machines(cores, 0.0, machine)
    memory = machines * (_value("spark_base") if spark else _value("history_memory"))
    stored = load.axes * load.rate * DAY * _value("stored_sample")
    return Bill(way, cores, memory, stored / DAY, stored, None, None, machines, machines)


def most_axes(way: str, load: Load, machine: Machine = Machine()) -> int:
    """So many axes at the rate of a load one machine carries in a way; 0: not a single one."""
    low, high = 0, MOST
    while high - low > 1:
        middle = (low + high) // 2
        carried = bill(way, Load(middle, load.rate, load.block), machine).machines == 1
        low, high = (middle, high) if carried else (low, middle)
    return low


def advice(load: Load, machine: Machine = Machine()) -> list[str]:
    """Which way is enough, and where the next one begins, in sentences."""
    most = {way: most_axes(way, load, machine) for way in WAYS[:3]}
    serve, process = bill("serve", load, machine), bill("process", load, machine)
    one = min(most["serve"], int(USED / (serve.cores / load.axes)))
    lines = [
        f"where a way ends: at {100 * USED:.0f} % of the cores or of the memory of a machine, whichever is full first, "
        "so that bursts and a restart can be caught up; one `pmfid serve` at that of one core, for it estimates on one",
        f"watched, with alarms and the page: one `pmfid serve` up to {_few(one)} axes at {load.rate:g} Hz, several "
        f"with axes of their own up to {_few(most['serve'])} on such a machine",
        f"estimates alone: one process with a ShardedFleet up to {_few(most['process'])} axes",
    ]
    if serve.machines == 1:
        own = "one process is" if serve.processes == 1 else f"{serve.processes} processes are"
        return [*lines, f"for {load.axes} axes: `pmfid serve`, of which {own} enough; nothing larger is needed"]
    if process.machines == 1:
        lines.append(
            f"for {load.axes} axes: one process is enough for the estimates; to watch them takes {serve.machines} such "
            "machines with `pmfid serve`, or Spark, which shares them out by itself"
        )
        return lines
    return [
        *lines,
        f"for {load.axes} axes: more than one machine ({process.machines} for the estimates, {serve.machines} to watch "
        "them): Spark, which shares axes out by itself and goes on where a machine fails",
    ]


def _few(number: float) -> str:
    """Two digits: no more of it is known."""
    return f"{float(f'{number:.2g}'):.0f}"


# --- as text ----------------------------------------------------------------------------------------------------------

#: Of a table with a row for each way.
HEADER = ("way", "cores", "memory", "network", "storage", "checkpoint", "restart", "processes", "machines")


def row(one: Bill) -> list[str]:
    """The cells of a way."""
    times = ["-" if time is None else f"{time:.2g} s" for time in (one.checkpoint, one.restart)]
    memory, network, storage = (_bytes(value) for value in (one.memory, one.network, one.storage))
    return [
        one.way, f"{one.cores:.2g}", memory, f"{network}/s", storage, *times, f"{one.processes}", f"{one.machines}"
    ]  # fmt: skip


def _bytes(value: float) -> str:
    """With a prefix, two to three digits."""
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if value >= factor:
            return f"{value / factor:.3g} {unit}"
    return f"{value:.3g} B"
