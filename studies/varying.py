"""Study of a process that changes all the time, which compares recursive methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.encoder import fine_counts
from pmfid.estimators.recursive import BCRLS, RLS
from pmfid.estimators.srivc import RSRIVC
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.signals import prbs
from pmfid.types import Floats
from studies.late_processes import simulate_varying
from studies.paper.truth import Study, Task, table

DT, SECONDS, CLOCK, CUTOFF = 0.01, 1000.0, 10, 10.0
NOISE_VARIANCE = 0.1
#: Seconds at the start that do not count.
START = 50.0
GOAL = 5.0
#: Method, memory [s], and memory of b0 [s].
CASES: dict[str, tuple[type[RLS | BCRLS | RSRIVC], float, float]] = {
    "`rls`, 12 s": (RLS, 12.0, 12.0),
    "`bcrls`, 12 s": (BCRLS, 12.0, 12.0),
    "`rsrivc`, 12 s": (RSRIVC, 12.0, 12.0),
    "`rls`, 4 s, b0 40 s": (RLS, 4.0, 40.0),
    "`bcrls`, 4 s, b0 40 s": (BCRLS, 4.0, 40.0),
    "`rsrivc`, 4 s, b0 40 s": (RSRIVC, 4.0, 40.0),
    "`rsrivc`, 4 s, b0 kept": (RSRIVC, 4.0, np.inf),
}
JUDGED = ("`rsrivc`, 12 s", "`rsrivc`, 4 s, b0 40 s")


def truth(t: Floats) -> Floats:
    """Return a0, a1, b0 (n, 3) at the times t (n,)."""
    return np.column_stack([160 - 90 * np.cos(2 * np.pi * t / SECONDS), 5 + 40 * t / SECONDS, np.full(t.size, 200.0)])


def tasks(seeds: int) -> list[Task]:
    return [(seed,) for seed in range(seeds)]


def work(seed: int) -> dict[str, Floats]:
    """Return for each case the root mean square errors (2, 3) in percent of the present value and of the RMS value."""
    rng = np.random.default_rng(seed)
    t: Floats = np.arange(round(SECONDS / DT), dtype=float) * DT
    u = prbs(t.size, clock=CLOCK, amplitude=1.0, rng=rng)
    known = truth(t)
    y = simulate_varying(lambda time: truth(np.array([time]))[0], 2, u, DT)
    encoder, counts = fine_counts(y + np.sqrt(NOISE_VARIANCE) * rng.standard_normal(t.size))
    late, errors = t >= START, {}
    for name, (cls, memory, slow) in CASES.items():
        options: dict[str, Any] = {"forgetting_of": {"b0": 1 - DT / slow}} if slow > memory else {}
        estimator = cls(TransferFunction(2, 0), encoder, DT, CUTOFF, forgetting=1 - DT / memory, **options)
        off, size = (estimator.run(u, counts).theta - known)[late], known[late]
        errors[name] = 100 * np.sqrt(
            [np.mean((off / size) ** 2, axis=0), np.mean(off**2, axis=0) / np.mean(size**2, axis=0)]
        )
    return errors


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    mean = {name: np.mean([results[(seed,)][name] for seed in range(seeds)], axis=0) for name in CASES}
    rows = [[name, *(f"{a:.1f} / {b:.1f}" for a, b in zip(*mean[name], strict=True))] for name in CASES]
    return [
        "## A process that changes all the time",
        "",
        f"y'' + a1 y' + a0 y = b0 u with a1 from 5 to 45 linearly, a0 = 160 - 90 cos(2 pi t / 1000 s), b0 = 200, T = "
        f"{DT:g} s, {SECONDS:g} s, random binary input of ±1 held for {CLOCK} samples, noise of variance "
        f"{NOISE_VARIANCE:g}, cutoff {CUTOFF:g} rad/s; {seeds} runs. Memory as the table says. That b0 changes ten "
        "times more slowly than the others, or never, is knowledge of the plant (`forgetting_of`). Root mean square "
        f"error after {START:g} s in percent of the value at that time / of the root mean square value.",
        "",
        *table(["method and memory", "a0", "a1", "b0"], rows),
        *(
            f"- {name}: every error below {GOAL:g} %: {'met' if np.max(mean[name]) < GOAL else '**not met**'}; the "
            f"largest is {np.max(mean[name]):.1f} %."
            for name in JUDGED
        ),
        "",
    ]


STUDY = Study("varying", tasks, work, write)
