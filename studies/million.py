"""Study a million axes in one process (cost of steps, checkpoints and restarts, effect of kills), as a page:
`python -m studies.million --out results/million.md`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pmfid import BCRLS, RIV, RLS, Drive
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import CART
from studies.paper.truth import table
from studies.sharded_runs import BEFORE, CALL, Cost, Kill, estimator, in_a_process, kills, per_sample

#: Axes of the fleets, axes of the fleets for samples, models and methods.
SIZES, SOME = (1_000, 10_000, 100_000, 1_000_000), 4096
CALLS = (1, 4, 8, 16, 32, 100, 300)
#: Samples in a call of the comparison of models and methods.
COMPARED = 50
GAIN = CART.input_gain
MODELS: Sequence[tuple[str, type[RecursiveEstimator], dict[str, object]]] = (
    ("rls", RLS, {}),
    ("bcrls", BCRLS, {}),
    ("bcrls, float32", BCRLS, {"precision": "float32"}),
    ("bcrls, a window", BCRLS, {"forgetting_scheme": "window"}),
    ("riv", RIV, {}),
    ("riv", RIV, {"model": Drive(GAIN, offset=True)}),
    ("riv", RIV, {"model": Drive(GAIN, friction="directional", spring=True)}),
    ("riv, a dead time", RIV, {"model": Drive(GAIN, dead_time="estimate")}),
)

HOW = """## How it is used

    fleet = pmfid.ShardedFleet("state", [estimator])      # takes up what the folder holds: fleet.restored tells
    handles = fleet.add(estimator, 1_000_000)             # int64, one for each axis
    tracks = fleet.run(handles, u, counts)                # the next n samples of all, or of some
    fleet.remove(handles[:100])
    fleet.checkpoint({"read until": 1234.5})              # of the shards that have changed since the last one

*Handles.* An axis is called by the number that `add` gave. After `remove` its place in memory goes to the next axis
that is added, its number to none: a call with it is refused, and says that this axis was removed.

*Shards.* Axes of one configuration lie in shards of 4096; any number of configurations stand side by side, each in
shards of its own. A shard is stepped in place where the axes of a call follow one another, else its states are
gathered and put back. Each axis has the bits that its estimator alone would give.

*Checkpoints.* Every shard has two files. A checkpoint writes the shards that have changed to the files that the last
checkpoint does not use, waits until the disk has them (`sync=False`: does not wait, and outlives the process, not the
power), and then replaces the older one of two lists of files by a rename. Until that rename the last checkpoint is
whole, after it the new one. Every file has a checksum and says whose states it holds; what is read is mapped,
checked, and taken only if samples could have made these numbers. A file that is not whole is set aside and named in
`fleet.restored.damaged`, and the older checkpoint is taken; where that is not whole either, the axes of the damaged
shards alone restart, and `fleet.restored.lost` says which. A full disk is an `OSError`, and the last checkpoint
stays. The states are written from where they lie: no copy is made, and other threads of the interpreter go on.

*Memory.* An axis of `bcrls` with three parameters has 1.5 kB, in memory once and on disk twice.
""".splitlines()


def _exponent(costs: Sequence[Cost], of: Callable[[Cost], float]) -> str:
    """Return the exponent with which a cost grows from the second-last size to the last."""
    if len(costs) < 2:
        return "-"
    (a, b) = costs[-2:]
    return f"{np.log(of(b) / of(a)) / np.log(b.axes / a.axes):.2f}"


def sizes(costs: Sequence[Cost]) -> list[str]:
    """Return the tables of times and of memory."""
    columns: Sequence[tuple[str, Callable[[Cost], float]]] = (
        ("add", lambda cost: cost.add.wall),
        (f"step of {CALL} samples", lambda cost: cost.step.wall),
        ("checkpoint", lambda cost: cost.first.wall),
        ("the next", lambda cost: cost.again.wall),
        ("of one shard", lambda cost: cost.few.wall),
        ("restore", lambda cost: cost.restore.wall),
    )
    rows = [[f"{cost.axes}", *(f"{of(cost):.3g}" for _, of in columns)] for cost in costs]
    rows.append(["grows with the power", *(_exponent(costs, of) for _, of in columns)])
    processor = [
        [f"{cost.axes}", *(f"{x.processor:.3g}" for x in (cost.add, cost.step, cost.first, cost.again, cost.few,
                                                          cost.restore))]
        for cost in costs
    ]  # fmt: skip
    memory = [
        [f"{cost.axes}", f"{cost.axes * cost.state / 1e6:.4g}", f"{cost.stepped - cost.empty:.4g}",
         f"{cost.restored - cost.empty:.4g}", f"{cost.disk / 1e6:.4g}"]
        for cost in costs
    ]  # fmt: skip
    header = ("axes", *(name for name, _ in columns))
    return [
        "Wall time [s], two threads, with whatever else the machine had to do; *the next* checkpoint is the one after "
        "another step of all:",
        "",
        *table(header, rows),
        "Processor time [s] of the same:",
        "",
        *table(header, processor),
        f"Memory [MB] beyond the {costs[-1].empty:.0f} MB of the interpreter with what it has loaded, after the "
        "calls, and of another process after the restore:",
        "",
        *table(("axes", "states", "in the process", "after a restore", "on disk"), memory),
    ]


def kill_lines(axes: int, found: Sequence[Kill]) -> list[str]:
    """Return the lines on the state after kills."""
    whole, newer, within = (sum(getattr(kill, name) for kill in found) for name in ("whole", "newer", "within"))
    times = ", ".join(f"{kill.after:.2f}" for kill in found)
    return [
        "## A kill in a checkpoint",
        "",
        f"{len(found)} times SIGKILL {times} s after the begin of a checkpoint of {axes} axes ({within} before it was "
        f"done), and a restart that goes on: in {whole} of {len(found)} the states are bit by bit those of the last "
        f"checkpoint that was done or, {newer} times, of the one under way, whose list was in its place already; "
        f"{sum(kill.damaged for kill in found)} files were damaged. "
        "`tests/test_sharded_fleet.py` kills at every named point, too.",
        "",
    ]


def samples() -> list[str]:
    """Return the table of the cost of a sample, by the number of samples in a call."""
    rows = []
    for number in CALLS:
        seconds, _ = per_sample(estimator(), SOME, number)
        rows.append([f"{number}", f"{1e9 * seconds:.0f}", f"{1e6 * seconds * number:.3g}"])
        print(rows[-1], flush=True)
    header = ("samples in a call", "of a sample [ns]", "of a call [µs]")
    return [
        "## Samples in a call",
        "",
        f"Processor time of an axis, `bcrls` with three parameters, {SOME} axes. Up to 7 samples the axes are computed "
        "one after the other, from 8 on side by side in vectors:",
        "",
        *table(header, rows),
    ]


def models() -> list[str]:
    """Return the table of the cost of methods and parameters."""
    rows = []
    for name, cls, options in MODELS:
        single = estimator(cls, **options)
        seconds, size = per_sample(single, SOME, COMPARED)
        rows.append([name, f"{len(single.names)}", ", ".join(single.names), f"{1e9 * seconds:.0f}", f"{size}"])
        print(rows[-1], flush=True)
    header = ("method", "parameters", "", "of a sample [ns]", "of an axis [bytes]")
    return ["## Methods and parameters", "", f"In calls of {COMPARED} samples:", "", *table(header, rows)[:-1]]


def page(costs: Sequence[Cost], found: Sequence[Kill]) -> str:
    """Return the page."""
    last = costs[-1]
    lines = [
        "# A million axes in one process",
        "",
        "Written by `python -m studies.million`: carts with masses of their own under random binary inputs, `bcrls`, "
        f"float64, {BEFORE} samples after each before anything is measured; each size in a process of its own.",
        "",
        *HOW,
        "## What it costs",
        "",
        *sizes(costs),
        *kill_lines(last.axes, found),
        *samples(),
        *models(),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="the page")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="(default: %(default)s)")
    parser.add_argument("--kills", type=int, default=5, help="of the largest (default: %(default)s)")
    options = parser.parse_args()
    costs = []
    for axes in sorted(options.sizes):
        costs.append(in_a_process(axes))
        print(costs[-1], flush=True)
    found = list(kills(costs[-1].axes, options.kills))
    options.out.write_text(page(costs, found), encoding="utf-8")


if __name__ == "__main__":
    main()
