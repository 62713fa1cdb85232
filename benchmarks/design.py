"""Measure the time to the best design with pmfid and with CasADi: `python -m benchmarks.design PAGE.md`.

The times are processor times, because the machine may be shared. All programs run on one thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from benchmarks.design_peers import Tried, casadi_starts
from pmfid.design.ascent import Climber
from pmfid.design.bounds import upper_bound
from pmfid.design.oracle import Oracle
from pmfid.design.problem import Limits, Problem
from pmfid.design.solver import setting, solve
from pmfid.models.drive import Drive

NOMINAL = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
CASES = [(1, "trace"), (2, "trace"), (2, "D"), (2, "A"), (3, "trace"), (3, "D"), (3, "A")]
#: (intervals, parameters, criterion, gap)
BOUNDS = [
    (40, 1, "trace", 0.01),
    (40, 1, "trace", 0.001),
    (40, 2, "D", 0.03),
    (40, 2, "A", 0.1),
    (40, 3, "D", 0.05),
    (200, 1, "trace", 0.01),
    (200, 2, "D", 0.03),
    (200, 2, "A", 0.1),
]
REACHED = 0.999
#: Starts of pmfid by the number of intervals, and starts of the peer.
STARTS, PEER_STARTS = {40: 1000, 200: 100}, 50

PAGE = """\
# How fast designs are found

Written by `python -m benchmarks.design results/design_benchmarks.md` with pmfid {pmfid}, highspy {highspy} and
CasADi {casadi} (IPOPT with MUMPS). The case: m = 1.5 kg, d = 6 N s/m, F_c = 0.6 N, 2 N/V; 0.4 m in 2 s from rest to
rest, |u| <= 3 V, speed at least 0.01 m/s on the way. Parameters: the mass; with the viscous friction; with the Coulomb
friction. Times are processor time on one thread, because the machine is shared.

## Starts

Part of the random starts that reaches 99.9 % of the best value found by any, and time per start. A start remembers the
local optima that earlier ones have left; "first" is the median of starts without that memory.

| intervals | parameters | criterion | starts | reach the best | median [ms] | mean [ms] | first [ms] |
|---:|---:|---|---:|---:|---:|---:|---:|
{starts}

## Against CasADi and IPOPT

Multiple shooting with the same exact steps and exact second derivatives; position, velocity and sensitivities are
variables, and the Cholesky factor of the information is for D and A; scaled, built once, not timed. {peer_starts}
random starts each, 40 intervals. Time to target: mean time of a start over the part that reaches 99.9 % of the best.

∞: no start of the peer comes that near.

Pyomo.DoE was not run: it needs an IPOPT program, and PyPI and Debian have the library alone.

| parameters | criterion | pmfid [ms] | no memory | CasADi reaches | median [ms] | to target [ms] | ratio | no memory |
|---:|---|---:|---:|---:|---:|---:|---:|---:|
{peers}

## Proofs

Processor time until the bound is within the gap, after the search.

| intervals | parameters | criterion | gap | time [s] |
|---:|---:|---|---:|---:|
{bounds}
"""


def problem(parameters: int, intervals: int = 40) -> Problem:
    """Return the problem of a move of 0.4 m in 2 s from rest to rest, with |u| <= 3 V and speed at least 0.01 m/s.

    The first `parameters` parameters are unknown.
    """
    limits = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
    names = tuple(NOMINAL)[:parameters]
    return Problem(Drive(2.0), NOMINAL, names, 2.0, intervals, limits, resolution=91e-6, end=(0.4, 0.0))


def own_starts(case: Problem, criterion: str, starts: int, seed: int, memory: bool = True) -> Tried:
    """Run the starts of pmfid; with `memory`, later starts do not leave the known local optima again."""
    ready = setting(case, criterion)
    oracle = Oracle(ready.inputs)
    oracle.feasible()
    climber = Climber(ready.maps, ready.rule, oracle)
    values, seconds = [], []
    for child in np.random.SeedSequence(seed).spawn(starts):
        if not memory:
            climber = Climber(ready.maps, ready.rule, oracle)
        began = time.process_time()
        value, _ = climber.start(np.random.default_rng(child))
        seconds.append(time.process_time() - began)
        values.append(float(np.exp(value)))
    return Tried(np.array(values), np.array(seconds))


def to_target(tried: Tried, best: float) -> tuple[float, float]:
    """Return (fraction of starts that reach the best, mean seconds of a start over that fraction)."""
    part = float(np.mean(tried.values >= REACHED * best))
    return part, float(tried.seconds.mean()) / part if part else np.inf


def start_rows() -> Iterator[str]:
    for intervals, starts in STARTS.items():
        for parameters, criterion in CASES:
            case = problem(parameters, intervals)
            own = own_starts(case, criterion, starts, seed=2)
            first = own_starts(case, criterion, 10, seed=3, memory=False)
            best = max(own.values.max(), first.values.max())
            times = (np.median(own.seconds), own.seconds.mean(), np.median(first.seconds))
            cells = [f"{to_target(own, best)[0]:.3f}", *(f"{1e3 * seconds:.1f}" for seconds in times)]
            yield f"| {intervals} | {parameters} | {criterion} | {starts} | {' | '.join(cells)} |"


def peer_rows() -> Iterator[str]:
    for parameters, criterion in CASES:
        case = problem(parameters)
        own = own_starts(case, criterion, 4 * PEER_STARTS, seed=1)
        single = own_starts(case, criterion, PEER_STARTS, seed=1, memory=False)
        peer = casadi_starts(case, criterion, PEER_STARTS, seed=1)
        best = max(tried.values.max() for tried in (own, single, peer))
        (_, mine), (_, alone), (part, theirs) = (to_target(tried, best) for tried in (own, single, peer))
        times = [f"{1e3 * mine:.1f}", f"{1e3 * alone:.1f}", f"{part:.2f}", f"{1e3 * np.median(peer.seconds):.1f}"]
        cells = [*times, *(f"{value:.0f}" for value in (1e3 * theirs, theirs / mine, theirs / alone))]
        yield f"| {parameters} | {criterion} | {' | '.join(cells)} |"


def bound_rows() -> Iterator[str]:
    for intervals, parameters, criterion, gap in BOUNDS:
        case = problem(parameters, intervals)
        best = solve(case, criterion)
        rule = setting(case, criterion).rule
        began = time.process_time()
        bound = upper_bound(case, rule, best.u, gap=gap, seconds=600.0) or np.inf
        seconds = time.process_time() - began
        reached = bound / best.value - 1.0
        yield f"| {intervals} | {parameters} | {criterion} | {100 * reached:.1f} % | {seconds:.1f} |"


def main(arguments: list[str]) -> None:
    if len(arguments) != 1:
        sys.exit("one path is needed: python -m benchmarks.design PAGE.md")
    text = PAGE.format(
        pmfid=version("pmfid"),
        highspy=version("highspy"),
        casadi=version("casadi"),
        peer_starts=PEER_STARTS,
        starts="\n".join(start_rows()),
        peers="\n".join(peer_rows()).replace("inf", "∞"),
        bounds="\n".join(bound_rows()),
    )
    Path(arguments[0]).write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
