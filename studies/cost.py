"""What the sums of `pmfid fleet cost` are made of, measured, and a page of them:
`python -m studies.cost --out results/cost.md`."""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pmfid import IV, RIV
from pmfid.estimators.configuration import like
from pmfid.fleet import cost
from pmfid.fleet.cost import HEADER, WAYS, Constant, Load, Machine, advice, bill, constants, most_axes, row
from pmfid.monitor import Monitor, Watch
from pmfid.monitor.calibration import Calibration, Tail
from pmfid.monitor.names import DETECTORS
from pmfid.monitor.scores import make_scale, scores
from pmfid.paper.truth import table
from pmfid.service.delivery import Block
from pmfid.service.wire.blocks import encode
from pmfid.simulation import CART
from studies.fleet_data import machines, rows
from studies.sharded_runs import CALL, Cost, estimator, in_a_process, motion, per_sample

CONSTANTS = Path(cost.__file__).parent / "cost.json"
#: Axes of the measured fleet, and of the calls: more than a cache holds.
AXES, SOME = 200_000, 60_000
FEW, MANY = (1, 4), (16, 100)
LOADS = ((100, 1000.0), (1000, 100.0), (10_000, 100.0), (100_000, 10.0), (100_000, 100.0), (1_000_000, 10.0))
MACHINES = (Machine(2, 16e9), Machine(16, 64e9), Machine(64, 256e9))
RATES = (1.0, 10.0, 100.0, 1000.0)
HERE = "results/cost.md"
#: A page of measurements -> the constants that it has, once it is there.
Reader = Callable[[str], Mapping[str, tuple[float, str, str]]]


# --- measured here ----------------------------------------------------------------------------------------------------


def _line(samples: Sequence[int]) -> tuple[float, float]:
    """Processor time of an axis in a call [s]: what the call costs, and each sample; on all processors, as in use."""
    seconds = [number * per_sample(estimator(), SOME, number, None, 0.5)[0] for number in samples]
    slope, start = np.polyfit(samples, seconds, 1)
    return max(0.0, float(start)), float(slope)


def measured(fleet: Cost) -> dict[str, Constant]:
    """Of one process; fleet: of many axes."""
    (few_call, few_sample), (call, sample), states = _line(FEW), _line(MANY), fleet.axes * fleet.state
    single = estimator()
    found = {
        "call": (
            call,
            "s",
            f"processor time of an axis in a call of {cost.FEW} samples or more, `bcrls`, 3 parameters",
        ),
        "sample": (sample, "s", "processor time of a sample in such a call"),
        "few_call": (few_call, "s", "processor time of an axis in a call of fewer samples"),
        "few_sample": (few_sample, "s", "processor time of a sample in a call of fewer"),
        "state": (fleet.state, "bytes", "state of an axis, `bcrls`, 3 parameters, float64"),
        "base": (1e6 * fleet.empty, "bytes", "a process with what it has loaded"),
        "result": (20 + 24 * len(single.names), "bytes", "estimates of an axis that a call gives"),
        "checkpoint_rate": (states / min(fleet.first.wall, fleet.again.wall), "bytes/s", "a checkpoint, synced"),
        "restore_axis": (fleet.restore.processor / fleet.axes, "s", "processor time to take an axis up, checked"),
        **_wire(),
        "serve_state": (_watched(), "bytes", "a watched axis in a checkpoint of `pmfid serve`"),
        "stored_sample": (_stored(), "bytes", "a sample in Parquet: axis, time, input, counts"),
    }
    return {name: Constant(*one, HERE) for name, one in found.items()}


def _wire() -> dict[str, tuple[float, str, str]]:
    sizes = [len(encode(Block("axis-000", 0, 0, 0.0, 0.01, np.full(n, 0.5), np.arange(n)))) for n in (10, 110)]
    each = (sizes[1] - sizes[0]) / 100
    return {
        "sample_bytes": (each, "bytes", "a sample in a block on the wire, and in the tables of a call"),
        "block_bytes": (sizes[0] - 10 * each, "bytes", "a block on the wire besides its samples"),
    }


def _watched() -> float:
    """Bytes of a watched axis; thresholds and scale, which all axes share, are as they come."""
    watched = estimator(RIV)
    theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    u, counts = (table[0] for table in motion(1, 0, 3000))
    blocks = scores(like(IV, watched, prefilter_zeros=None), theta, u.astype(float), counts.astype(np.int64))
    tails: dict[str, Tail] = {name: Tail(10.0, 0.0, 1.0, 1.0, ()) for name in DETECTORS}
    calibration = Calibration(theta, make_scale(blocks[20:]), (), tails, np.ones(theta.size), 1.0)
    return Monitor(watched, calibration, Watch()).saved().row_type().itemsize


def _stored() -> float:
    """Bytes of a sample as Polars writes Parquet."""
    (machine,) = machines(1, 0, 600.0, 3)
    log = rows(machine, 60_000, 3)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "log.parquet"
        log.write_parquet(path)
        return path.stat().st_size / log.height


# --- measured elsewhere -----------------------------------------------------------------------------------------------


def tables(text: str) -> Iterator[list[dict[str, str]]]:
    """The tables of a page, each as rows by the names of its columns."""
    for block in re.findall(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        lines = [[cell.strip() for cell in line.strip("|\n ").split("|")] for line in block.splitlines()]
        yield [dict(zip(lines[0], line, strict=False)) for line in lines[2:]]


def _first(text: str) -> float:
    return float(re.findall(r"[\d.]+", text)[0])


def service(text: str) -> dict[str, tuple[float, str, str]]:
    """Of results/service_load.md: the slowest of its runs decides, and memory grows by what it did between them."""
    runs = next(one for one in tables(text) if one and "1e6 samples/s" in one[0])
    block = int(re.search(r"blocks of (\d+)", text)[1])  # type: ignore[index]
    cores = [_first(run["cores of service, broker, machines"]) / (1e6 * _first(run["1e6 samples/s"])) for run in runs]
    axes = [_first(run["axes"]) for run in runs]
    slope, start = np.polyfit(axes, [1e6 * _first(run["memory [MB]"]) for run in runs], 1)
    return {
        "serve_block": (block * max(cores), "s", f"time of a core for a block of {block} samples in `pmfid serve`"),
        "serve_samples": (block, "", "samples of such a block"),
        "serve_memory": (float(slope), "bytes", "memory of a watched axis"),
        "serve_base": (float(start), "bytes", "memory of a service besides its axes"),
    }


def history(text: str) -> dict[str, tuple[float, str, str]]:
    """Of results/fleet_history.md: the largest of its runs."""
    run = next(one for one in tables(text) if one and "samples per processor second" in one[0] and "MiB" in one[0])[-1]
    rate = 1e6 * _first(run["samples per processor second"])
    return {
        "history_sample": (1 / rate, "s", "processor time of a sample in `pmfid fleet history`"),
        "history_memory": (2**20 * _first(run["MiB"]), "bytes", "memory of `pmfid fleet history`, whatever the size"),
    }


def engines(text: str) -> dict[str, tuple[float, str, str]]:
    """Of results/fleet_engines.md: the start is in the processor time, so a short run is dearer than a long one."""
    runs = next(one for one in tables(text) if one and "engine" in one[0])
    run = next(one for one in runs if one["engine"] == "spark")
    rate = 1e6 * _first(run["per processor second"])
    return {
        "spark_history_sample": (1 / rate, "s", "processor time of a stored sample on Spark, its start among them"),
        "spark_base": (2**20 * _first(run["MiB, all processes"]), "bytes", "Java and Python of a machine with Spark"),
    }


def streamed(text: str) -> dict[str, tuple[float, str, str]]:
    """Of results/fleet_stream.md: the largest of the rates that hold, with what a process needs without any samples,
    much of a small rate."""
    runs = next(one for one in tables(text) if one and "states written with a batch" in one[0])
    run = max((one for one in runs if one["holds"] == "yes"), key=lambda one: _first(one["samples/s"]))
    each = _first(run["processors"]) / _first(run["samples/s"])
    return {"stream_sample": (each, "s", "time of a core for a sample in Structured Streaming with state")}


PAGES: Mapping[str, Reader] = {
    "results/service_load.md": service,
    "results/fleet_history.md": history,
    "results/fleet_engines.md": engines,
    "results/fleet_stream.md": streamed,
}


def refreshed() -> dict[str, Constant]:
    """All constants: measured, or read from their pages."""
    found = dict[str, Constant]()
    for page, read in PAGES.items():
        found |= {name: Constant(*one, page) for name, one in read(Path(page).read_text("utf-8")).items()}
    return found | measured(in_a_process(AXES))


def write_constants(found: Mapping[str, Constant]) -> None:
    """As `pmfid.fleet.cost` reads them: four digits, more of it is not known."""
    raw = {name: vars(one) | {"value": float(f"{one.value:.4g}")} for name, one in sorted(found.items())}
    CONSTANTS.write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")
    constants.cache_clear()


# --- the page ---------------------------------------------------------------------------------------------------------


def loads(machine: Machine) -> Iterator[str]:
    """A table for each load."""
    for axes, rate in LOADS:
        load = Load(axes, rate)
        yield from (f"### {axes} axes at {rate:g} Hz", "")
        yield from table(HEADER, [row(bill(way, load, machine)) for way in WAYS])
        yield from (*(f"- {line}" for line in advice(load, machine)), "")


def count(number: int) -> str:
    """Two digits, with a prefix."""
    for factor, unit in ((1e6, " M"), (1e3, " k")):
        if number >= factor:
            return f"{float(f'{number / factor:.2g}'):g}{unit}"
    return f"{float(f'{number:.2g}'):g}"


def most() -> Iterator[str]:
    """How many axes one machine carries."""
    for machine in MACHINES:
        yield from (f"A machine of {machine.cores} cores and {machine.memory / 1e9:g} GB:", "")
        rows_ = [[way, *(count(most_axes(way, Load(1, rate), machine)) for rate in RATES)] for way in WAYS]
        yield from table(("way", *(f"{rate:g} Hz" for rate in RATES)), rows_)


def checked(fleet: Cost) -> list[str]:
    """What the sums say of a fleet that was measured."""
    said = bill("process", Load(fleet.axes, CALL))
    pairs = [
        ["cores", f"{said.cores:.3g}", f"{fleet.step.processor:.3g}"],
        ["memory [MB]", f"{said.memory / 1e6:.4g}", f"{fleet.stepped:.4g}"],
        ["on disk [MB]", f"{said.storage / 1e6:.4g}", f"{fleet.disk / 1e6:.4g}"],
        ["checkpoint [s]", f"{said.checkpoint:.3g}", f"{fleet.first.wall:.3g}"],
    ]
    return [
        f"{fleet.axes} axes, {CALL} samples in a call, a call each second, by the sums and as measured once, with "
        "whatever else the machine had to do:",
        "",
        *table(("", "said", "measured"), pairs),
    ]


def page(fleet: Cost) -> str:
    """The page; fleet: another one than that of the constants."""
    known = sorted(constants().values(), key=lambda one: (one.page, one.what))
    sources = [[one.what, f"{one.value:.3g} {one.unit}".strip(), one.page] for one in known]
    lines = [
        "# What a fleet costs, on paper",
        "",
        "Written by `python -m studies.cost`, which measures what is measured here, reads the rest from the pages that "
        "it names, and writes `src/pmfid/fleet/cost.json`. The same sums for any fleet and machine:",
        "",
        "    pmfid fleet cost --axes 20000 --rate 50 --cores 16 --memory 64",
        "",
        f"Cores are busy ones on average; a machine is filled to {100 * cost.USED:.0f} % of its cores and memory. A "
        "call or a message of an axis comes each second. *process*: a `ShardedFleet` (results/million.md), estimates "
        "alone; *serve*: `pmfid serve`, which watches, one core for each process; *spark stream*: the same kernel "
        "under Structured Streaming; *history*, *spark history*: a day of stored samples estimated once a day. "
        "Storage: two generations of checkpoints, for histories the samples of a day. A dash: not of this way, or not "
        "measured. "
        "Of `pmfid serve` blocks of 50 samples are measured; one of fewer is taken to cost as much, so slow axes with "
        "short blocks are dearer here than they are: send longer blocks.",
        "",
        "## By load",
        "",
        f"On machines of {MACHINES[1].cores} cores and {MACHINES[1].memory / 1e9:g} GB:",
        "",
        *loads(MACHINES[1]),
        "## Axes that one machine carries",
        "",
        *most(),
        "## Said and measured",
        "",
        *checked(fleet),
        "## What the sums are made of",
        "",
        *table(("", "value", "from"), sources)[:-1],
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="the page")
    parser.add_argument("--check", type=int, default=600_000, help="axes that the sums are held against")
    options = parser.parse_args()
    write_constants(refreshed())
    options.out.write_text(page(in_a_process(options.check)), encoding="utf-8")


if __name__ == "__main__":
    main()
