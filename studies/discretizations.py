"""Study of the discretisation without noise: paper, matched, and exact with repeated passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.ls import LS, refine_estimate
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.process import SimulatedProcess, simulate_process
from pmfid.simulation.signals import prbs
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table

DT = 0.01
SAMPLES = 4000
FASTEST = (0.01, 0.03, 0.1, 0.3)
PASSES = 6
#: Range of the poles, fastest over slowest.
RANGE = 10.0
GOAL = 1e-6


def plant_at_random(n: int, relative_degree: int, fastest: float, seed: int) -> SimulatedProcess:
    """Return a random stable plant whose fastest pole times the period is `fastest`.

    Half of the pole pairs are complex, and zeros may lie in the right half-plane.
    """
    rng = np.random.default_rng(seed)
    poles: list[complex] = []
    while len(poles) < n:
        size = RANGE ** -rng.uniform()
        if n - len(poles) >= 2 and rng.uniform() < 0.5:
            damping = rng.uniform(0.2, 0.9)
            pole = size * complex(-damping, np.sqrt(1 - damping**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-size))
    fast = fastest / DT
    roots = np.array(poles) * fast / np.max(np.abs(poles))
    m = n - relative_degree
    zeros = -fast * RANGE ** -rng.uniform(size=m) * rng.choice([-1.0, 1.0], m)
    b = np.atleast_1d(np.poly(zeros)) * fast**relative_degree
    a = np.poly(roots).real
    return SimulatedProcess(
        f"{n}, {relative_degree}", tuple(b), tuple(a), DT, max(1, round(0.5 / fastest)), SAMPLES, fast, ()
    )


def record_of(plant: SimulatedProcess, seed: int) -> tuple[Floats, Floats]:
    """Return a random binary input and the output without noise, each (SAMPLES,)."""
    u = prbs(plant.samples, clock=plant.clock, amplitude=1.0, rng=np.random.default_rng(seed))
    return u, simulate_process(plant.b, plant.a, u, plant.dt)


def tasks(seeds: int) -> list[Task]:
    return [
        (n, r, fastest, seed)
        for n in range(1, 5)
        for r in range(1, min(n, 3) + 1)
        for fastest in FASTEST
        for seed in range(seeds)
    ]


def work(n: int, relative_degree: int, fastest: float, seed: int) -> Floats:
    """Return the largest relative error of a parameter: paper, matched, exact after 1 to PASSES passes; inf means a
    failure.
    """
    plant = plant_at_random(n, relative_degree, fastest, seed)
    u, y = record_of(plant, seed)
    estimator = LS(TransferFunction(n, n - relative_degree), Encoder(1.0), plant.dt, plant.cutoff)
    fits = [replace(estimator, discretization=kind).fit_output(u, y).theta for kind in ("paper", "matched")]
    try:
        passes = list(refine_estimate(estimator, u, y).history[:PASSES])
    except NotIdentifiableError:
        passes = [np.full(plant.theta.size, np.inf)]
    passes += [passes[-1]] * (PASSES - len(passes))
    return np.array([np.max(np.abs(theta / plant.theta - 1)) for theta in (*fits, *passes)])


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows, worst = [], 0.0
    for n in range(1, 5):
        for r in range(1, min(n, 3) + 1):
            for fastest in FASTEST:
                error = np.max([results[n, r, fastest, seed] for seed in range(seeds)], axis=0)
                worst = max(worst, float(error[-1]))
                rows.append([str(n), str(r), f"{fastest:g}", *(f"{value:.1e}" for value in error)])
    verdict = "met" if worst < GOAL else "**not met**"
    return [
        "## Discretisation: exactness without noise",
        "",
        f"Random stable plants, {seeds} of each kind (poles within a factor of {RANGE:g}, half of the pairs complex, "
        f"zeros on both sides), ZOH input, {SAMPLES} samples, `ls` with the cutoff at the fastest pole. Largest "
        "relative error of any parameter in any of the plants: `paper` and `matched`, then `exact` after each of its "
        "passes, which start from `matched`.",
        "",
        *table(
            ["n", "n - m", "pole times T", "paper", "matched", *(f"exact, {k}" for k in range(1, PASSES + 1))], rows
        ),
        f"Check, `exact` below {GOAL:g} after at most {PASSES} passes: {verdict}; the worst is {worst:.1e}.",
        "",
    ]


STUDY = Study("discretizations", tasks, work, write)
