"""Write a page on the bits and costs of the exported C: `python -m tests.firmware.study --out results/footprint.md`."""

from __future__ import annotations

import argparse
import platform
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid import Drive, Encoder, REdge
from pmfid.config.axis import load_axis
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import RECURSIVE
from pmfid.kernel.saved import configuration, shape_of
from pmfid.kernel.structures import edge_structures, structures
from pmfid.records.record import read_record
from pmfid.simulation import CART, capture_edges, resolution_of, simulate_drive
from pmfid.simulation.scenarios import CART_DT, make_scenario
from tests.conftest import EMPS
from tests.firmware.build import CLANG, GCC, M4F, M7
from tests.firmware.footprint import cost
from tests.firmware.replay import PREFIX, difference, exported, exported_edges

SAMPLES = 100_000
#: Samples with edges, and instants of their motion in a sample.
EDGE_SAMPLES, FINE = 20_000, 20
RUNS = [(GCC, level) for level in ("-O0", "-O2", "-O3")] + [(CLANG, level) for level in ("-O0", "-O2", "-O3")]
RUNS += [(M4F, "-O2"), (M4F, "-O3"), (M7, "-O2"), (M7, "-O3")]
AXIS = Path(__file__).parents[2] / "examples" / "emps.toml"

PAGE = """# What an export costs, and its bits

Written by `make firmware`; {compilers}.

## Footprint on a Cortex-M4F

Drive with mass, viscous and Coulomb friction, filters of order 2. Flash, at -O2: code and constants that the linker
keeps where a program calls `init`, `step` and `theta`, with the configuration and what they take of libc and libgcc
(the arithmetic of float64). State: RAM per axis. Stack, at -O2: deepest path from `pmf_step` on, by the compiler's call
graph. Instructions, at -O3: of one step, mean and most over the samples of the self-test, in the emulator.

{footprint}

## Bits

Python and the exported C give the same bits of status, estimate, variances and innovation after every sample, and of
the state after the last: {runs}. The emulated processors are those of QEMU's boards mps2-an386 and mps2-an500.

{bits}
"""


def records() -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.int64], Drive, Encoder, float, float]]:
    """Yield the name, input, counts, model, encoder, sample period [s] and cutoff [rad/s] of each record."""
    cart = make_scenario("prbs", seed=0, increments=256, duration=SAMPLES * CART_DT)
    encoder = Encoder(cart.resolution, bits=16)
    yield "cart", cart.motion.u, cart.counts, Drive(2.0), encoder, CART_DT, 50.0
    if EMPS.exists():
        record = read_record(EMPS, load_axis(AXIS))
        yield "EMPS", record.u, record.counts, Drive(1.0, offset=True), Encoder(record.resolution), record.dt, 50.0


def estimators() -> Iterator[tuple[str, RecursiveEstimator, NDArray[np.float64], NDArray[np.int64]]]:
    for name, u, counts, drive, encoder, dt, cutoff in records():
        for cls in RECURSIVE:
            for precision in ("float32", "float64"):
                estimator = cls(drive, encoder, dt, cutoff, forgetting=0.999, precision=precision)
                yield name, estimator, u, counts


def edge_estimators() -> Iterator[tuple[REdge, tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]]]:
    """Yield the recursion over edges, and input, counts and ages of the cart."""
    u = make_scenario("prbs", seed=0, increments=256, duration=EDGE_SAMPLES * CART_DT).motion.u
    motion = simulate_drive(CART, np.repeat(u, FINE), CART_DT / FINE)
    for lines, offset in ((16, False), (64, False), (16, True)):
        step = resolution_of(lines)
        counts, ages = capture_edges(motion, step, 0.3 * step, every=FINE, tick=1e-6)
        for precision in ("float32", "float64"):
            model, encoder = Drive(2.0, offset=offset), Encoder(step)
            yield (
                REdge(model, encoder, CART_DT, lines=lines, tick=1e-6, memory=10.0, precision=precision),
                (u, counts, ages),
            )


def edge_cost_row(name: str, estimator: REdge, folder: Path) -> str:
    measured = cost(folder, PREFIX)
    sizes = edge_structures(int(estimator.lines or 0), estimator.precision, len(estimator.names))
    ram, saved = sizes["pmf_state_t"].itemsize, sizes["pmf_saved_t"].itemsize
    values = (measured.flash, ram, saved, measured.stack, measured.mean, measured.most)
    return f"| {name} | {estimator.precision} | " + " | ".join(map(str, values)) + " |"


def page() -> str:
    bits = ["| record | samples | method | precision | compared | different |", "|---|---:|---|---|---:|---:|"]
    costs = [
        "| method | precision | flash [byte] | state [byte] | saved [byte] | stack [byte] | instructions, mean | most |"
    ]
    costs.append("|---|---|---:|---:|---:|---:|---:|---:|")
    for name, estimator, u, counts in estimators():
        with tempfile.TemporaryDirectory() as folder:
            exported(estimator, Path(folder), u, counts)
            apart = [difference(Path(folder), *run) for run in RUNS]
            wrong = sum(place is not None for place in apart)
            bits.append(f"| {name} | {u.size} | {estimator.method} | {estimator.precision} | {len(apart)} | {wrong} |")
            print(bits[-1], flush=True)
            if name == "cart":
                costs.append(cost_row(estimator, Path(folder)))
                print(costs[-1], flush=True)
        if name == "cart":
            bare = replace(estimator, encoder=replace(estimator.encoder, guard=False))
            with tempfile.TemporaryDirectory() as folder:
                exported(bare, Path(folder), u, counts)
                costs.append(cost_row(bare, Path(folder)))
    for estimator, record in edge_estimators():
        with tempfile.TemporaryDirectory() as folder:
            exported_edges(estimator, Path(folder), record)
            wrong = sum(difference(Path(folder), *run) is not None for run in RUNS)
            name = f"{estimator.method}, {estimator.lines} lines" + ", offset" * estimator.model.offset
            bits.append(f"| edges | {record[0].size} | {name} | {estimator.precision} | {len(RUNS)} | {wrong} |")
            costs.append(edge_cost_row(name, estimator, Path(folder)))
            print(f"{bits[-1]}\n{costs[-1]}", flush=True)
    names = ", ".join(f"{target.name} {level}" for target, level in RUNS)
    return PAGE.format(compilers=compilers(), footprint="\n".join(costs), bits="\n".join(bits), runs=names)


def cost_row(estimator: RecursiveEstimator, folder: Path) -> str:
    measured = cost(folder, PREFIX)
    shape = shape_of(configuration(estimator.make_kernel(estimator.forgetting), estimator.precision))
    sizes = structures(shape, estimator.precision)
    ram, saved = sizes["pmf_state_t"].itemsize, sizes["pmf_saved_t"].itemsize
    values = (measured.flash, ram, saved, measured.stack, measured.mean, measured.most)
    name = estimator.method + ("" if estimator.encoder.guard else ", no guard")
    return f"| {name} | {estimator.precision} | " + " | ".join(map(str, values)) + " |"


def compilers() -> str:
    """Return the names and versions of the compilers."""
    found = [f"this computer: {platform.machine()}"]
    for name in ("gcc", "clang", "arm-none-eabi-gcc", "qemu-system-arm"):
        line = subprocess.run([name, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
        version = re.search(r"\d+\.\d+(\.\d+)?", line.rpartition(")")[2] or line) or re.search(
            r"\d+\.\d+(\.\d+)?", line
        )
        found.append(f"{name} {version[0] if version else line}")
    return ", ".join(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    options = parser.parse_args()
    options.out.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
