"""Accuracy study in open loop: every method with several filters and encoders, against the Cramér-Rao bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmfid.types import Floats
from studies.paper.truth import SLOW, TIME_CONSTANT, Study, Task, cramer_rao, estimate, percent, scenario_record, table

TIME_CONSTANTS = (2, 3, 5, 10)
INCREMENTS = (4096, 1024, 512, 256, 128)
OFF_LINE = ("ls", "bcls", "iv")
ON_LINE = ("rls", "bcrls", "riv")
#: Relative difference up to which an on-line method repeats its off-line method.
SAME = 1e-6
#: Largest bias of the mass by iv [%].
GOAL = 0.3


def tasks(seeds: int) -> list[Task]:
    return [(tc, inc, seed) for tc in TIME_CONSTANTS for inc in INCREMENTS for seed in range(seeds)]


def work(time_constant: int, increments: int, seed: int) -> dict[str, Floats]:
    """Return theta of every method, and the bound's variances under "bound"; slow methods have one filter only."""
    record = scenario_record("prbs", seed, increments)
    methods: tuple[str, ...] = OFF_LINE + ON_LINE
    if time_constant == TIME_CONSTANT and seed < 10:
        methods += SLOW
    result = {method: estimate(method, record, time_constant).theta for method in methods}
    return result | {"bound": cramer_rao(record.u, record.resolution)}


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    same, lines = _repeated(results)
    methods = [method for method in OFF_LINE + ON_LINE if method not in same]
    lines = [
        "## Open loop: bias, scatter and efficiency",
        "",
        f"Random binary input of 3 V (clock 10 samples), 30 s, {seeds} seeds. Mass: bias ± standard deviation over the "
        "seeds, in percent; forgetting 1, the last value of the recursive methods. Tf: filter time constant.",
        "",
        *lines,
        "",
    ]
    cells = {
        (tc, inc): [results[tc, inc, seed] for seed in range(seeds)] for tc in TIME_CONSTANTS for inc in INCREMENTS
    }
    lines += table(
        ["Tf", "increments", *methods],
        [[f"{tc} T", str(inc), *(_spread(runs, m) for m in methods)] for (tc, inc), runs in cells.items()],
    )
    lines += _goal(cells)
    lines += [
        "",
        "Efficiency of the mass: Cramér-Rao bound over the observed variance (scatter about the mean, so that a bias "
        "does not show). The bound takes white Gaussian noise of variance resolution²/12 on every position; a "
        "quantiser's error is neither, and a method that uses the edges of the counts may go beyond the bound. "
        "Bound: standard deviation of the mass in percent, mean over the seeds' inputs.",
        "",
    ]
    rows = [[f"{tc} T", str(inc), *_efficiencies(runs, methods)] for (tc, inc), runs in cells.items()]
    lines += table(["Tf", "increments", "bound [%]", *methods], rows)
    return lines + _slow(seeds, results)


def _mass(runs: list[dict[str, Floats]], method: str) -> Floats:
    return np.array([percent(run[method])[0] for run in runs])


def _spread(runs: list[dict[str, Floats]], method: str) -> str:
    mass = _mass(runs, method)
    return f"{mass.mean():+.3f} ± {mass.std(ddof=1):.3f}" if mass.size > 1 else f"{mass.mean():+.3f}"


def _bound(runs: list[dict[str, Floats]]) -> float:
    """Return the variance of the mass [%^2]."""
    return float(np.mean([run["bound"][0] for run in runs])) * (100 / 1.07) ** 2


def _efficiencies(runs: list[dict[str, Floats]], methods: list[str]) -> list[str]:
    bound = _bound(runs)
    if len(runs) < 2:
        return [f"{np.sqrt(bound):.4f}", *("–" for _ in methods)]
    return [f"{np.sqrt(bound):.4f}", *(f"{bound / _mass(runs, m).var(ddof=1):.2g}" for m in methods)]


def _repeated(results: Mapping[Task, Any]) -> tuple[list[str], list[str]]:
    """Return the on-line methods that repeat their off-line methods, and lines of text on the comparison."""
    same, lines = [], []
    for off, on in zip(OFF_LINE, ON_LINE, strict=True):
        apart = max(float(np.max(np.abs(run[on] / run[off] - 1))) for run in results.values())
        if apart <= SAME:
            same.append(on)
            lines.append(f"- `{on}` ends on `{off}` (largest relative difference of any parameter below {SAME:g}).")
        else:
            lines.append(
                f"- `{on}` differs from `{off}`: by up to {100 * apart:.2g} % in the worst parameter of a run."
            )
    return same, lines


def _goal(cells: Mapping[tuple[int, int], list[dict[str, Floats]]]) -> list[str]:
    worst = max(cells, key=lambda cell: abs(_mass(cells[cell], "iv").mean()))
    bias = _mass(cells[worst], "iv").mean()
    verdict = "met" if abs(bias) < GOAL else "**not met**"
    return [
        f"Check, |bias| of `iv` below {GOAL} % everywhere: {verdict}; the largest is {bias:+.3f} % "
        f"(Tf = {worst[0]} T, {worst[1]} increments)."
    ]


def _slow(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    if not SLOW:
        return []
    count = min(seeds, 10)
    rows = []
    for inc in INCREMENTS:
        runs = [results[TIME_CONSTANT, inc, seed] for seed in range(count)]
        cells = [
            f"{_spread(runs, m)} ({e})"
            for m, e in zip(("iv", *SLOW), _efficiencies(runs, ["iv", *SLOW])[1:], strict=True)
        ]
        rows.append([str(inc), *cells])
    intro = (
        f"The methods that fit the simulated position, first {count} seeds, Tf = {TIME_CONSTANT} T where a filter is "
    )
    intro += (
        "used, `iv` on the same seeds next to them; in brackets the efficiency, uncertain by half with so few runs."
    )
    return [intro, "", *table(["increments", "iv", *SLOW], rows)]


STUDY = Study("open-loop", tasks, work, write)
