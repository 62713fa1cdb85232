"""Study of the verdicts on transfer functions: coverage of bars, right alarms, and recommendations of the search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtr, ndtri

from pmfid.diagnostics.processes import assess, flags_on
from pmfid.diagnostics.tuning import TUNING
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.srivc import SRIVC, make_problem, spread
from pmfid.linear.experiment import HOLDS, Experiment, Hold
from pmfid.linear.order import UNSTABLE, OrderCandidate, accepted_first, search_structure
from pmfid.linear.process import Process
from pmfid.linear.solve import visit
from pmfid.models.transfer_function import TransferFunction
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table
from studies.process_records import (
    INPUTS,
    LENGTHS,
    NOISES,
    RandomPlant,
    closed_record,
    loop_noise,
    open_record,
    random_plant,
)

QUANTILE = 1.96
#: Number of records for each search.
SEARCHES = 5
SEARCHED = 1000


@dataclass(frozen=True, eq=False)
class Said:
    """The status, and the errors (1 + n,) of gain and poles over their bars."""

    status: tuple[str, ...]
    z: Floats


def estimator_of(plant: RandomPlant, model: TransferFunction | None = None) -> SRIVC:
    """Return the estimator that a user with known numbers of poles and zeros would take."""
    model = model or TransferFunction(plant.a.size - 1, plant.b.size - 1)
    return SRIVC(model, Encoder(1.0), plant.dt, min(2 * plant.bandwidth, 1.9 / plant.dt))


def identified(estimator: SRIVC, record: Experiment) -> tuple[Process, Floats, tuple[str, ...]]:
    """Identify as `pmfid identify` does: return the process, theta (p,) and the status. Raises NotIdentifiableError."""
    fit = estimator.fit_experiments([record])
    problem = make_problem(estimator, [record])
    theta = fit.theta / problem.structure.scale(problem.rate)
    checks = assess(problem, theta, estimator.equation.delay)
    if not checks.depends:
        raise NotIdentifiableError("chance alone explains as much")
    return fit.process, fit.theta, flags_on(checks, fit.process)


def tasks(seeds: int) -> list[Task]:
    places = [(kind, noise, seed) for kind in INPUTS for noise in NOISES for seed in range(seeds)]
    found: list[Task] = [(what, *place) for what in ("open", "closed") for place in places]
    return found + [("order", *place) for place in places if place[-1] % SEARCHES == 0]


def work(what: str, kind: str, noise: str, seed: int) -> Any:
    rng = _generator(kind, noise, seed)
    return {"open": _open, "closed": _closed, "order": _order}[what](kind, noise, seed, rng)


def _generator(kind: str, noise: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, INPUTS.index(kind), NOISES.index(noise)])


def _open(kind: str, noise: str, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the verdicts with the hold of the record (`right`) and with the other one (`wrong`)."""
    plant, hold = random_plant(rng), HOLDS[int(rng.integers(2))]
    record = open_record(plant, kind, noise, LENGTHS[seed % len(LENGTHS)], hold, rng)
    other: Hold = "foh" if hold == "zoh" else "zoh"
    return {"right": _judged(plant, record), "wrong": _judged(plant, replace(record, hold=other))}


def _judged(plant: RandomPlant, record: Experiment) -> Said | None:
    """Return the verdict, or None if the method refuses the record."""
    try:
        process, _, status = identified(estimator_of(plant), record)
    except NotIdentifiableError:
        return None
    mine, true = linear_sum_assignment(np.abs(np.log(process.poles[:, None] / plant.poles)))
    poles = (process.poles[mine] - plant.poles[true]).real / process.poles_std[mine, 0]
    return Said(status, np.r_[(process.gain - plant.gain) / process.gain_std, poles])


def _closed(kind: str, noise: str, seed: int, rng: np.random.Generator) -> Said | None:
    plant = random_plant(rng, 3)
    record = closed_record(plant, kind, noise, LENGTHS[seed % len(LENGTHS)], rng)
    return _judged(plant, record)


def _best_chance(noise: str, seed: int) -> float:
    """Return the power of the best test for a loop whose reference is white, with false alarms as rare as in pmfid.

    The test knows all spectra and the controller (Neyman and Pearson 1933). The mean of the test's log-likelihood ratio
    is half of the information that input and noise share. The information is the number of samples times the ratio of
    noise power to reference power, which is also its variance.
    """
    rng = _generator("white", noise, seed)
    plant, samples = random_plant(rng, 3), LENGTHS[seed % len(LENGTHS)]
    size = loop_noise(plant, "white", noise, samples, rng)
    return float(ndtr(size * np.sqrt(samples) - ndtri(1 - TUNING.false_alarm)))


def _order(kind: str, noise: str, seed: int, rng: np.random.Generator) -> tuple[bool, float, float]:
    """Return whether the first model is fitted and accepted, its fit on fresh data [%], and the best fit of all."""
    plant = random_plant(rng, 3)
    record, fresh = (open_record(plant, kind, noise, SEARCHED, "zoh", rng) for _ in range(2))

    def refusal(row: OrderCandidate) -> str:
        try:
            status = identified(estimator_of(plant, _model(row)), record)[2]
        except NotIdentifiableError as error:
            return str(error)
        return UNSTABLE if "unstable" in status else ""

    search = accepted_first(search_structure([record], estimator_of(plant).cutoff), refusal)
    fits = [_fresh_fit(plant, fresh, row, row.theta) for row in search.candidates if row.settled]
    try:
        theta = identified(estimator_of(plant, _model(search.best)), record)[1]
    except NotIdentifiableError:
        return False, np.nan, max(fits)
    return not search.best.refused, _fresh_fit(plant, fresh, search.best, theta), max(fits)


def _model(row: OrderCandidate) -> TransferFunction:
    return TransferFunction(row.n, row.m, row.delay)


def _fresh_fit(plant: RandomPlant, record: Experiment, row: OrderCandidate, theta: Floats) -> float:
    """Return the percentage of another record that theta (p,) explains, with fitted initial conditions."""
    problem = make_problem(estimator_of(plant, _model(row)), [record])
    start = np.zeros((len(problem.stretches), problem.structure.n))
    with np.errstate(all="ignore"):
        left = visit(problem, theta / problem.structure.scale(problem.rate), start).cost
    return 100 * (1 - float(np.sqrt(left / spread(problem))))


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## What is said of transfer functions",
        "",
        f"Random processes of 1 to 4 poles, {seeds} runs for each input and noise, {', '.join(map(str, LENGTHS))} "
        "samples in turn, 15 to 40 dB, held or in straight lines at random, `srivc` with the right numbers of poles "
        "and zeros. "
        f"Coverage: of the intervals of ±{QUANTILE} std of gain and poles, of runs with an empty status and of all; "
        "refused: no result; false: `feedback`.",
        "",
    ]
    header = ["", "gain, empty [%]", "poles, empty [%]", "all [%]", "empty [%]", "refused", "false [%]"]
    for hold, text in (("right", "With the hold that the input had:"), ("wrong", "With the other hold:")):
        rows = [_row(name, hold, results, test) for name, test in _groups()]
        lines += [text, "", *table(header, rows)]
    return [*lines, *_loops(seeds, results), *_searches(results)]


def _groups() -> list[tuple[str, Callable[[Task], bool]]]:
    groups: list[tuple[str, Callable[[Task], bool]]] = [("all", lambda task: True)]
    groups += [(kind, partial(_has, 1, kind)) for kind in INPUTS]
    groups += [(f"{noise} noise", partial(_has, 2, noise)) for noise in NOISES]
    return groups + [(f"{n} samples", partial(_long, i)) for i, n in enumerate(LENGTHS)]


def _has(place: int, value: object, task: Task) -> bool:
    return bool(task[place] == value)


def _long(index: int, task: Task) -> bool:
    return bool(task[3] % len(LENGTHS) == index)


def _row(name: str, hold: str, results: Mapping[Task, Any], test: Callable[[Task], bool]) -> list[str]:
    runs = [result[hold] for task, result in results.items() if task[0] == "open" and test(task)]
    given = [run for run in runs if run is not None]
    calm = [run for run in given if not run.status]
    return [
        name,
        _covered([run.z[:1] for run in calm]),
        _covered([run.z[1:] for run in calm]),
        _covered([run.z for run in given]),
        _percent([not run.status for run in given]),
        f"{len(runs) - len(given)}/{len(runs)}",
        _percent(["feedback" in run.status for run in given]),
    ]


def _loops(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    runs = {task: result for task, result in results.items() if task[0] == "closed" and result is not None}
    old = [run for task, run in runs.items() if task[1] != "white"]
    new = [(task, run) for task, run in runs.items() if task[1] == "white"]
    if not old or not new:
        return []
    chance = float(np.mean([_best_chance(task[2], task[3]) for task, _ in new]))
    quiet = [run.z for _, run in new if "feedback" not in run.status]
    share_old, share_new = (_percent(["feedback" in run.status for run in some]) for some in (old, [r for _, r in new]))
    return [
        f"Under PI control at 20 to 80 dB `feedback` is found in {share_old} % of {len(old)} loops whose reference is "
        f"a sweep, sines, steps or a random binary signal. Of {len(new)} whose reference is new in every sample it is "
        f"found in {share_new} %. No test could do much better: with all spectra and the controller known the most "
        f"powerful one finds {100 * chance:.1f} %, for the answer to the noise drowns in the reference. It does as "
        f"little harm: where `feedback` is not said, the intervals cover {_covered(quiet)} %.",
        "",
    ]


def _covered(z: Sequence[Floats]) -> str:
    return _percent(np.abs(np.concatenate(z)) < QUANTILE) if z else "–"


def _percent(found: Sequence[bool] | Any) -> str:
    return f"{100 * np.mean(found):.1f}" if len(found) else "–"


def _searches(results: Mapping[Task, Any]) -> list[str]:
    runs = [result for task, result in results.items() if task[0] == "order"]
    lost = np.array([best - first for fitted, first, best in runs if fitted])
    if not runs:
        return []
    return [
        f"`pmfid terms` on {SEARCHED} samples, {len(runs)} runs: its first is fitted and accepted in "
        f"{sum(run[0] for run in runs)}; on fresh data its fit is within a point of the best of all structures in "
        f"{int(np.sum(lost <= 1.0))}, the worst is {np.max(lost):.2f} points below.",
        "",
    ]


STUDY = Study("process-confidence", tasks, work, write)
