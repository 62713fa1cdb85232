"""Study whether the search names the terms of a drive: `python -m studies.terms --out results/terms.md`."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import pmfid
from pmfid.estimators.results import Fit
from pmfid.pipeline.terms import AMBIGUOUS, UNMODELLED, TermSearch
from pmfid.simulation import Machine
from studies.paper.truth import Study, Task, table
from studies.sections import Page, by_name
from studies.term_machines import HELD_BACK, KINDS, MOTIONS, SAMPLES, Bench, kind_of, machine_of, truths

#: Seed of the halves: the first whose halves have equally many machines with none, one and two terms.
DRAWN = 16
#: Successive searches, each from the model of the preceding search.
MOST_SEARCHES = 3
#: Error bars within which the truth must lie, and relative error that does not matter.
BARS, SMALL = 3.0, 1e-3


@dataclass(frozen=True)
class Named:
    """The result of the searches.

    `wrong` are terms not in the machine, and `missing` terms that were not found. `searches` counts the searches until
    a search adds no term; 0 means that each search added a term. `bars` and `worst` are the largest error in its error
    bars and relative to the value. `outside` counts parameters beyond BARS and SMALL. `worse` are terms kept in spite
    of a larger held-out error, and `sizeless` terms without a value or an error bar. `seconds` is the time of the first
    search.
    """

    motion: str
    wrong: tuple[str, ...]
    missing: tuple[str, ...]
    searches: int
    bars: float
    worst: float
    outside: tuple[str, ...]
    worse: tuple[str, ...]
    sizeless: tuple[str, ...]
    status: tuple[str, ...]
    seconds: float

    @property
    def right(self) -> bool:
        return not self.wrong and not self.missing


def tasks(seeds: int) -> list[Task]:
    """Return half of the machines with each of two seeds; each half has all kinds and equally many terms."""
    order = np.random.default_rng(DRAWN).permutation(len(truths())).tolist()
    return [(number, 0) for number in order[: seeds * len(order) // 2]]


def work(number: int, seed: int) -> Named | str:
    """Return the result, or the error's text if the search is refused."""
    from time import process_time

    bench, machine, record, motion = machine_of(number, seed)

    def searched(model: pmfid.Drive) -> TermSearch:
        encoder = pmfid.Encoder(record.resolution)
        return pmfid.search_terms(record.u, record.counts, model=model, dt=bench.dt, encoder=encoder)

    begin = process_time()
    try:
        found = first = searched(pmfid.Drive(bench.drive.input_gain))
        seconds, searches, named = process_time() - begin, 1, set(first.added)
        while found.added and searches < MOST_SEARCHES:
            found, searches = searched(found.model), searches + 1
            named |= set(found.added)
    except pmfid.PmfidError as error:
        return str(error)
    errors = {name: (abs(off) / bar, abs(off) / size) for name, off, bar, size in _errors(found, bench, machine)}
    truth, kept = set(truths()[number]), [one for one in first.weighed if one.kept]
    return Named(
        motion,
        tuple(sorted(named - truth)),
        tuple(sorted(truth - named)),
        0 if found.added else searches,
        max((off for off, _ in errors.values()), default=math.nan),
        max((part for _, part in errors.values()), default=math.nan),
        tuple(name for name, (off, part) in errors.items() if not (off <= BARS or part <= SMALL)),
        tuple(one.setting for one in kept if one.with_it > one.without),
        tuple(one.setting for one in kept if not one.values or not all(bar > 0 for _, _, bar, _ in one.values)),
        first.status,
        seconds,
    )


def true_values(machine: Machine) -> dict[str, float]:
    """Return the machine's true values by parameter name; waves have their size."""
    drive, more = machine.drive, machine.asymmetry
    known = {"mass": drive.mass, "viscous_friction": drive.viscous_friction, "offset": drive.offset}
    known |= {"coulomb_friction": drive.coulomb_friction, "stribeck_friction": machine.stribeck}
    known |= {"stribeck_speed": machine.stribeck_speed, "quadratic_friction": machine.quadratic}
    known |= {"stiffness": machine.stiffness, "dead_time": machine.dead_time, "lag": machine.lag}
    known |= {"cogging": machine.cogging}
    for name in ("viscous_friction", "coulomb_friction"):
        known |= {f"{name}_forward": (1 + more) * known[name], f"{name}_backward": (1 - more) * known[name]}
    return known


def _errors(found: TermSearch, bench: Bench, machine: Machine) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, error, error bar and size of each parameter. The load of a spring has no truth: its length counts
    from the first count, which is known to a count."""
    trial, fit, known = found.chosen.trial, found.chosen.fit, true_values(machine)
    equation = trial.model.equation
    names = [*equation.names, *dict(equation.further)]
    values = dict(zip(names, trial.theta.tolist(), strict=True))
    bars = dict(zip(names, _bars(fit, len(names)), strict=True))
    for wave in {name.removesuffix("_sin") for name in names if name.endswith("_sin")}:
        sin, cos = f"{wave}_sin", f"{wave}_cos"
        values[wave] = math.hypot(values[sin], values[cos])
        bars[wave] = math.hypot(values[sin] * bars[sin], values[cos] * bars[cos]) / values[wave]
    for name, value in values.items():
        if name in known and not (name == "offset" and machine.stiffness):
            yield name, value - known[name], bars[name], abs(known[name]) or abs(value)


def _bars(fit: Fit | None, size: int) -> list[float]:
    return [math.nan] * size if fit is None else np.asarray(fit.theta_std).tolist()


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    found = {task: one for task, one in results.items() if isinstance(one, Named)}
    lines = [
        "## Random machines",
        "",
        f"{len(results)} machines of {len(KINDS)} kinds from 1e-5 kg m2 to 500 kg: {_counts(results)}. Mass, "
        f"friction, terms, encoder, motion ({', '.join(MOTIONS)}) and length ({SAMPLES[0]} to {SAMPLES[1]} samples) "
        f"are drawn. Held back: no rule of the search was chosen on {', '.join(HELD_BACK)}. The search has no cutoff, "
        "no pitch and no size given.",
        "",
        "Right: just the terms that the machine has. Converged: the search, begun with the model that the last one has "
        f"found, adds nothing, at most {MOST_SEARCHES} searches in all. Within the bars: of the right ones those of "
        f"which every parameter is within {BARS:g} error bars of the truth, or within {100 * SMALL:g} %; strictly: "
        "within the error bars alone. Worse: terms kept although the held-out error is larger with them. Said: of the "
        f"wrong ones those with `{UNMODELLED}` or `{AMBIGUOUS}` in their status.",
        "",
    ]
    header = ["machines", "terms", "runs", "refused", "right", "converged", "within the bars", "strictly", "worse"]
    header += ["without size", "said", "seconds, median", "most"]
    rows = [_row(held_back, number, results) for held_back in (False, True, None) for number in (0, 1, 2, None)]
    lines += table(header, [row for row in rows if row])
    wrong = [
        (task, one) for task, one in found.items() if not one.right or one.outside or one.worse or not one.searches
    ]
    lines += ["What is not right, not converged or not within the bars:", ""]
    lines += table(
        ["machine", "motion", "truth", "found otherwise", "outside", "worst [bars]", "worst [%]", "status"],
        [
            [
                f"{task[0]}, {kind_of(task[0])}",
                one.motion,
                ", ".join(truths()[task[0]]) or "none",
                _difference(one) or "–",
                ", ".join((*one.outside, *(f"worse: {term}" for term in one.worse))) or "–",
                f"{one.bars:.1f}",
                f"{100 * one.worst:.2g}",
                ", ".join(one.status) or "–",
            ]
            for task, one in wrong
        ],
    )
    lines += [f"Machine {task[0]}, {kind_of(task[0])}: {one}." for task, one in results.items() if isinstance(one, str)]
    return lines


def _counts(results: Mapping[Task, Any]) -> str:
    sizes = [len(truths()[task[0]]) for task in results]
    return ", ".join(f"{sizes.count(k)} with {said}" for k, said in enumerate(("no term", "one term", "two terms")))


def _row(held_back: bool | None, number: int | None, results: Mapping[Task, Any]) -> list[str]:
    runs = [
        one
        for task, one in results.items()
        if held_back in (None, kind_of(task[0]) in HELD_BACK) and number in (None, len(truths()[task[0]]))
    ]
    found = [one for one in runs if isinstance(one, Named)]
    if not runs or (held_back is None and number is not None):
        return []
    right, bad = [one for one in found if one.right], [one for one in found if not one.right]
    said = sum(bool({UNMODELLED, AMBIGUOUS} & set(one.status)) for one in bad)
    seconds = [one.seconds for one in found] or [math.nan]
    return [
        "all" if held_back is None else "held back" if held_back else "others",
        "all" if number is None else f"{number}",
        f"{len(runs)}",
        f"{len(runs) - len(found)}",
        f"{len(right)}",
        f"{sum(one.searches > 0 for one in found)}",
        f"{sum(not one.outside for one in right)}",
        f"{sum(one.bars <= BARS for one in right)}",
        f"{sum(len(one.worse) for one in found)}",
        f"{sum(len(one.sizeless) for one in found)}",
        f"{said} of {len(bad)}" if bad else "–",
        f"{np.median(seconds):.1f}",
        f"{max(seconds):.0f}",
    ]


def _difference(one: Named) -> str:
    return " ".join([*(f"+{key}" for key in one.wrong), *(f"-{key}" for key in one.missing)])


STUDY = Study("random", tasks, work, write)
INTRODUCTION = """\
`pmfid terms` begins with the model of AXIS.toml and adds one term at a time: Stribeck, quadratic or directional
friction, a load, a spring, a dead time or a lag, and, where a turn or a pitch is given or found, gravity and cogging. A
term is proposed by its score test at the best fit so far. It is kept if the likelihood ratio is beyond chance and free
runs over parts of the record that it was not fitted to are no worse. After each addition every term is left out once:
one goes that the others have made superfluous, or without which other parts are predicted better. A lag is tried next
to every dead time, and a dead time next to every lag. Two terms are tried at once where no single one suffices.

A pitch that is not given is looked for where the model does not explain every count and no other term is kept: by score
tests of the simulated position and by a balance of forces at the measured places, each over up to 150 pitches of the
travel. From the peaks of both, least squares move the pitch, too. Moves that are all alike hardly tell a pitch of the
travel more or less; then the neighbours are tried as well, and the edges of the counts decide."""
PAGE = Page("terms", "Which terms does a drive have?", INTRODUCTION, by_name(STUDY), 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
