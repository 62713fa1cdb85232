"""Study of a published table: white noise on output and input, and on the output alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.encoder import fine_counts
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.srivc import SRIVC
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.process import PLANTS, simulate_process
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table

#: Ratio of the powers of signal and noise.
SNR = 10.0
PLANT = PLANTS["non-minimum-phase"]
#: Values that the documentation of CONTSID prints for noise on output and input: its a1, a2, b0, b1 are a1, a0, b1, b0
#: here.
PRINTED = {
    "CONTSID, IVSVF (printed)": (1.903, 0.974, 0.856, -0.970),
    "CONTSID, SRIVC (printed)": (1.967, 0.977, 0.905, -0.927),
    "CONTSID, errors in variables (printed)": (2.000, 1.001, 0.998, -0.999),
}
ORDER = (1, 0, 3, 2)
CASES = ("output and input", "output")
GOAL = 1.0


def tasks(seeds: int) -> list[Task]:
    return [(case, seed) for case in CASES for seed in range(seeds)]


def work(case: str, seed: int) -> dict[str, Floats]:
    """Return theta (p,) of each method."""
    rng = np.random.default_rng(seed)
    u = np.roll(PLANT.u, rng.integers(PLANT.u.size))
    y = simulate_process(PLANT.b, PLANT.a, u, PLANT.dt)
    y = y + np.std(y) / np.sqrt(SNR) * rng.standard_normal(y.size)
    if case == CASES[0]:
        u = u + np.std(u) / np.sqrt(SNR) * rng.standard_normal(u.size)
    encoder, counts = fine_counts(y)
    model = TransferFunction(2, 1)
    found = {}
    for cls in (LS, BCLS, SRIVC):
        options: dict[str, Any] = {"prefilter_zeros": PLANT.zeros} if cls is BCLS else {}
        found[cls.method] = cls(model, encoder, PLANT.dt, PLANT.cutoff, **options).fit(u, counts).theta
    return found


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## A published table",
        "",
        f"G(s) = (s - 1) / (s^2 + 2 s + 1), T = {PLANT.dt:g} s, {PLANT.samples} samples, white noise at "
        f"{10 * np.log10(SNR):g} dB, {seeds} runs: mean ± standard deviation over the runs. The names are those of the "
        "published table: s^2 + a1 s + a2 and b0 s + b1. How its input was made is not printed; ours is a maximum "
        f"length sequence of 10 stages, clock {PLANT.clock}. None of our methods allows for noise on the input.",
        "",
    ]
    for case in CASES:
        rows = [[name, *(f"{value:.3f}" for value in values)] for name, values in PRINTED.items()]
        rows = rows if case == CASES[0] else []
        for method in results[case, 0]:
            theta = np.array([results[case, seed][method] for seed in range(seeds)])[:, ORDER]
            spread = theta.std(axis=0, ddof=1) if seeds > 1 else np.zeros(4)
            cells = [f"{mean:.3f} ± {std:.3f}" for mean, std in zip(theta.mean(axis=0), spread, strict=True)]
            rows.append([f"`{method}`", *cells])
        lines += [f"Noise on {case}:", "", *table(["method", "a1 = 2", "a2 = 1", "b0 = 1", "b1 = -1"], rows)]
    theta = np.array([results[CASES[1], seed]["srivc"] for seed in range(seeds)])
    worst = float(np.max(np.abs(100 * (theta.mean(axis=0) / PLANT.theta - 1))))
    verdict = "met" if worst <= GOAL else "**not met**"
    return [*lines, f"Check, `srivc` within {GOAL:g} % with a noise-free input: {verdict}; {worst:.2f} %.", ""]


STUDY = Study("published", tasks, work, write)
