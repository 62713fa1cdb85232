"""Study the history of a fleet of a thousand axes (found changes, time, memory), as a page:
`python -m studies.fleet_history --out results/fleet_history.md`.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmfid import fleet
from pmfid.fleet.history import History
from studies.fleet_data import IN_A_FILE, write_fleet
from studies.paper.truth import table

#: Bytes of a row as arrays: name of the axis, time, input, counts.
ROW = 32
#: Fractions of the data set whose time and memory are compared; beyond 1, its axes repeat under names with this ending.
PARTS, COPY = (0.25, 0.5, 1.0, 2.0, 4.0), " copy "
#: Size of the extrapolation [GB], and its largest factor.
FARTHER, FAR = 100.0, 20.0
#: Sizes for the peers: simultaneous axes, samples of each, and samples of a single axis.
SIDE_BY_SIDE, SAMPLES, SINGLE = 1000, 2000, 20_000
#: Processes of the pool.
POOL = 2


HOW = """## How it is used

    pmfid fleet history lake/ --config AXIS.toml --axis machine --period day --out history

`lake/` holds Parquet or Arrow files, partitioned in any way: by folders `machine=7/`, by date, one for each axis,
many axes in one, rows in any order. AXIS.toml names the columns and what all axes have in common; `--type COLUMN`
tells types apart. `history/` gets `fleet.html`, and as tables `periods.parquet` (estimates with their bars,
quality and findings of every axis and period), `axes.parquet` (who needs attention, and why) and
`problems.parquet` (what could not be used). In Python:

    found = pmfid.fleet.estimate(frame_or_folder, axis="AXIS.toml", by="machine")  # found.periods, found.axes

Every axis is estimated in segments of 60 s, each from nothing: so errors are independent, a change shows within a
minute, and the same rows give the same bytes whatever files or threads they come from. An axis is
named where its change, drift or distance from its type goes beyond `[monitor] tolerance` by more than chance makes
of the whole fleet.

Friction goes up and down with temperature and lubrication. Where a step or a straight line explains the past of an
axis no better than a random walk does, the axis is said to wander (`kind` is `wanders`, with its size) and is not
named. A movement of which the history holds no more than a rising part looks like a drift and is reported as one.
Where a clear gap parts the axes of one type, it holds several sorts of machines (`several_sorts` among the problems):
each axis is then compared with its own sort. Sorts whose axes overlap, or of fewer than 8 axes or a tenth, are not
distinguished: the spread of the type is then wider, and it takes more to be named.

Files in which many axes are mixed row by row are sorted by Polars into temporary files, in the folder of `--out`. A
Delta table is read by its log (`pip install 'pmfid[delta]'`).
One segment in 16 is searched for missing forces: an input that bends, quadratic friction, friction at rest. The bars
contain the errors by these forces. The findings say what else is off, and the quality of a period and of an axis is
then `doubt`: `unmodelled`, `dead_time` and `feedback` if at least half of the segments of a period have it, and of all
periods of an axis if a part of its segments has it (a tenth, a quarter, a quarter); `one_way` if estimates from moves
forward contradict those from moves backward, as with a load, or if there is one direction alone; `one_size` if the
input has one size alone, where saturation or a dead zone looks like another force per input.

Rests longer than four settling times of the filters take no place in a segment, so that a segment may span up to ten
times its length, and no more than a period. A few moves from rest to rest are gone through more than once, until the
method has settled; the bars count them once. `visible` in `axes.parquet` is the relative step of any parameter that
would be named if it came in the middle of the history; an axis in which it is 10 % or more has `little_information`
among its findings. `python -m studies.fleet_kinds` has what became of motion of many kinds, simulated by an integrator
of its own.

""".splitlines()


@dataclass(frozen=True)
class Cost:
    """Samples, wall and processor time [s], and peak memory [MiB]."""

    samples: int
    wall: float
    cpu: float
    memory: float


@dataclass(frozen=True)
class Found:
    """The comparison of a history to the truth.

    `right` counts the changed axes that are named, and `others` are further named axes. `causes` and `times` count the
    correct causes and times among the right axes. `error` and `apart` are the root mean square error of the size,
    relative and in standard deviations. `next` is the largest score of an unnamed axis; an axis with 1 would be named.
    """

    changed: int
    right: int
    others: list[str]
    causes: int
    times: int
    error: float
    apart: float
    next: float


def found_of(history: History, truth: Mapping[str, Mapping[str, float | str]]) -> Found:
    """Compare a history to the truth."""
    named = {row["axis"]: row for row in history.named.iter_rows(named=True)}
    right = [axis for axis in truth if axis in named]
    errors = np.array([named[axis]["size"] - (float(truth[axis]["factor"]) - 1) for axis in right])
    bars = np.array([named[axis]["std"] for axis in right])
    times = [named[axis]["since"] <= float(truth[axis]["time"]) <= named[axis]["until"] for axis in right]
    quiet = history.axes.filter(~history.axes["named"])["score"]
    return Found(
        len(truth),
        len(right),
        [f"{axis}: {named[axis]['why']}" for axis in named if axis not in truth],
        sum(named[axis]["cause"] == truth[axis]["cause"] for axis in right),
        sum(times),
        float(np.sqrt(np.mean(errors**2))) if right else math.nan,
        float(np.sqrt(np.mean((errors / bars) ** 2))) if right else math.nan,
        float(quiet.max() or 0.0),  # type: ignore[arg-type]
    )


def measured(data: Path, config: Path, out: Path) -> tuple[History, Cost]:
    """Run one call on a data set in this process, and measure its cost."""
    wall, cpu = time.perf_counter(), time.process_time()
    history = fleet.estimate(data, axis=config, by="machine", period="10min", out=out)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return history, Cost(history.samples, wall, cpu, memory)


def in_a_process(folder: Path, part: float) -> tuple[Cost, Found]:
    """Run the call on a part of the files in a separate process, which has its own memory."""
    command = [sys.executable, "-m", "studies.fleet_history", "--measure", str(folder), "--part", str(part)]
    reported = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return Cost(**reported["cost"]), Found(**reported["found"])


def measure(folder: Path, part: float) -> dict[str, object]:
    """Run the call on a part of the files."""
    files = sorted((folder / "data").iterdir())
    taken = files[: max(1, round(min(part, 1.0) * len(files)))]
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(dir=folder) as name:
        data = Path(name) / "data"
        data.mkdir()
        for path in taken:
            (data / path.name).symlink_to(path.resolve())
        for copy in range(1, round(part)):
            truth |= {f"{axis}{COPY}{copy}": truth[axis] for axis in list(truth) if COPY not in axis}
            for path in taken:
                renamed(path, data / f"{copy}-{path.name}", f"{COPY}{copy}")
        history, cost = measured(data, folder / "axis.toml", Path(name) / "out")
    known = set(history.axes["axis"].to_list())
    found = found_of(history, {axis: change for axis, change in truth.items() if axis in known})
    return {"cost": vars(cost), "found": vars(found)}


def renamed(path: Path, copy: Path, ending: str) -> None:
    """Copy the rows under other names of axes, in a separate process, so that only the history counts as memory."""
    code = (
        "import sys, polars as pl; a, b, ending = sys.argv[1:]; "
        "pl.scan_parquet(a).with_columns(pl.col('machine') + ending).sink_parquet(b)"
    )
    subprocess.run([sys.executable, "-c", code, str(path), str(copy), ending], check=True)


def numpy_rate() -> float:
    """Return samples per second of recursive least squares with three parameters, in NumPy over axes. The peer has no
    filters, no instruments and no error bars."""
    rng = np.random.default_rng(0)
    phi = rng.standard_normal((SAMPLES, SIDE_BY_SIDE, 3))
    z = phi @ np.array([1.0, 2.0, 3.0]) + rng.standard_normal((SAMPLES, SIDE_BY_SIDE))
    theta, P = np.zeros((SIDE_BY_SIDE, 3)), np.tile(1e6 * np.eye(3), (SIDE_BY_SIDE, 1, 1))
    start = time.process_time()
    for k in range(SAMPLES):
        gain = np.einsum("aij,aj->ai", P, phi[k])
        gain /= 0.999 + np.einsum("ai,ai->a", phi[k], gain)[:, None]
        theta += gain * (z[k] - np.einsum("ai,ai->a", phi[k], theta))[:, None]
        P = (P - gain[:, :, None] * np.einsum("ai,aij->aj", phi[k], P)[:, None, :]) / 0.999
    return SAMPLES * SIDE_BY_SIDE / (time.process_time() - start)


def padasip_rate(seed: int = 0) -> float:
    """Return samples per second of padasip on one axis, or NaN without padasip."""
    try:
        import padasip  # type: ignore[import-untyped]
    except ImportError:
        return math.nan
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((SINGLE, 3))
    z = phi @ np.array([1.0, 2.0, 3.0]) + rng.standard_normal(SINGLE)
    method = padasip.filters.FilterRLS(n=3, mu=0.999)
    start = time.process_time()
    for k in range(SINGLE):
        method.adapt(z[k], phi[k])
    return SINGLE / (time.process_time() - start)


def pool_rate() -> float:
    """Return the median rate of padasip in a pool of processes, with one axis after the other in each process."""
    with ProcessPoolExecutor(POOL) as pool:
        return float(np.median(list(pool.map(padasip_rate, range(2 * POOL)))))


def farther(costs: Sequence[Cost]) -> list[str]:
    """Return the cost of a data set of FARTHER, extrapolated by straight lines through the measured costs."""
    sizes = ROW * np.array([cost.samples for cost in costs]) / 1e9
    if len(costs) < 3 or not sizes[-1] > FARTHER / FAR:
        return []
    pace, slope, grown = (
        float(np.polyfit(sizes, [getattr(cost, name) for cost in costs], 1)[0]) for name in ("wall", "cpu", "memory")
    )
    most = max(cost.memory for cost in costs) + max(grown, 0.0) * (FARTHER - float(sizes[-1]))
    return [
        f"Extrapolated along straight lines to {FARTHER:g} GB, which was not run: {pace * FARTHER / 60:.0f} minutes, "
        f"{slope * FARTHER / 60:.0f} of a processor, {most:.0f} MiB.",
    ]


def page(axes: int, runs: Sequence[tuple[Cost, Found]], whole: int) -> str:
    """Return the page; `runs` are on parts of the files, and the run of number `whole` reads each file once."""
    cost, found = runs[whole]
    sizes, cpu = (np.log([getattr(cost, name) for cost, _ in runs]) for name in ("samples", "cpu"))
    exponent = float(np.polyfit(sizes, cpu, 1)[0]) if len(runs) > 1 else math.nan
    costs = [
        [f"{cost.samples / 1e6:.0f} M", f"{ROW * cost.samples / 1e9:.3g}", f"{cost.wall:.0f}", f"{cost.cpu:.0f}",
         f"{cost.samples / cost.wall / 1e6:.2f} M", f"{cost.samples / cost.cpu / 1e6:.2f} M", f"{cost.memory:.0f}"]
        for cost, _ in runs
    ]  # fmt: skip
    side, one = numpy_rate(), pool_rate()
    peers = [
        ["pmfid fleet history: reading, filters, `riv`, bars, verdicts", f"{cost.samples / cost.cpu / 1e6:.3g} M"],
        [f"NumPy over {SIDE_BY_SIDE} axes, recursive least squares alone", f"{side / 1e6:.3g} M"],
        [
            f"padasip `FilterRLS.adapt` in a pool of {POOL} processes, recursive least squares alone",
            f"{one / 1e6:.3g} M",
        ],
    ]
    header = ("samples", "size [GB]", "wall [s]", "processor [s]", "samples/s", "samples per processor second", "MiB")
    lines = [
        "# The history of a fleet",
        "",
        f"Written by `python -m studies.fleet_history`: {axes} simulated axes at 100 Hz (`python -m "
        "studies.fleet_data`), each with masses and frictions of its own (5 % apart) and an input of its own; "
        f"{found.changed} of them change mass, friction or force per input by 8 to 30 % at a time of their own. "
        "`pmfid fleet history` knows the type, not the axes.",
        "",
        *HOW,
        "## Who is found",
        "",
        f"{found.right} of the {found.changed} that changed are named, {len(found.others)} others. Of those found "
        f"{found.causes} have the right cause, and {found.times} the minute in which it came. The size is off by "
        f"{100 * found.error:.2g} % (root mean square), {found.apart:.2g} of its standard deviations. The most "
        f"suspicious axis that is not named has {found.next:.2g} of the evidence that it takes.",
        "",
        *[f"- {other}" for other in found.others],
        *([""] if found.others else []),
        "## What it costs",
        "",
        "Parts of the same data set, each in a process of its own, from Parquet to tables, two threads; wall "
        "time with whatever else the machine had to do; beyond the whole data set with its axes again by other names. "
        f"Size: as arrays of {ROW} bytes a row. Processor time grows with the power {exponent:.3f} of the size.",
        "",
        *table(header, costs),
        *farther([cost for cost, _ in runs]),
        "",
        "Next to what else could be done, in samples per second of one processor. The others get regressors that are "
        "ready:",
        "",
        *table(("", "samples per processor second"), peers)[:-1],
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--folder", type=Path, help="of a fleet that is there already")
    parser.add_argument("--largest", type=float, default=2.0, help="Of the sizes: N times the fleet.")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--part", type=float, default=1.0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure is not None:
        print(json.dumps(measure(arguments.measure, arguments.part)))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = arguments.folder or Path(name)
        if arguments.folder is None:
            changed = max(1, round(0.03 * arguments.axes))
            write_fleet(folder, arguments.axes, changed, arguments.hours, seed=11, workers=2)
        parts = [part for part in PARTS if part * arguments.axes >= IN_A_FILE and part <= arguments.largest] or [1.0]
        text = page(arguments.axes, [in_a_process(folder, part) for part in parts], parts.index(1.0))
    arguments.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
