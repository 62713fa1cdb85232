"""The mass by every method with coarser and coarser encoders, in open loop and under position control."""

from __future__ import annotations

from pathlib import Path

from pmfid.estimators.auto import AUTO
from pmfid.simulation import CART, CART_DT, make_scenario
from studies.paper.estimates import OFF_LINE, mass_of, mass_score, record_of, track_of, track_score
from studies.paper.figure import PaperFigure, Results, Task
from studies.paper.merit import Merit, Score, merit

#: Scenario -> increments of the encoder.
RUNS = {"prbs": (4096, 1024, 512, 256), "stop-and-go": (4096, 1024, 512, 256, 128, 64), "moves": (256,)}
DIRECT = ("rls", "bcrls")
TIME_CONSTANT = 3  # samples: 30 ms
DURATION = 20.0  # [s]
#: Forgetting of riv; the other methods never forget.
FORGETTING = 0.99
AFTER = 10.0  # [s]


def off_line(name: str) -> tuple[str, ...]:
    """Return the off-line methods for a scenario. Open loop leaves out the slow method, which is no worse there."""
    return tuple(m for m in OFF_LINE if m != AUTO or name != "prbs")


def tasks(seeds: int) -> list[Task]:
    return [(name, inc, seed) for name, encoders in RUNS.items() for inc in encoders for seed in range(seeds)]


def work(name: str, increments: int, seed: int) -> dict[str, Score]:
    """Score the last value of a method without forgetting, and all later samples of riv."""
    record = record_of(make_scenario(name, seed=seed, increments=increments, duration=DURATION))
    last, late = slice(-1, None), slice(round(AFTER / CART_DT), None)
    scores = {m: track_score(track_of(m, record, TIME_CONSTANT, 1.0), last, CART.mass) for m in DIRECT}
    scores |= {m: mass_score(mass_of(m, record, TIME_CONSTANT), CART.mass) for m in off_line(name)}
    return scores | {"riv": track_score(track_of("riv", record, TIME_CONSTANT, FORGETTING), late, CART.mass)}


def without_encoder() -> dict[str, float]:
    """Return the error of the mass [%] under stop-and-go with a nearly exact encoder, by method."""
    record = record_of(make_scenario("stop-and-go", increments=2**24, duration=DURATION))
    scores = {m: track_score(track_of(m, record, TIME_CONSTANT, 1.0), slice(-1, None), CART.mass) for m in DIRECT}
    scores["iv"] = mass_score(mass_of("iv", record, TIME_CONSTANT), CART.mass)
    return {method: 100 * found.error for method, found in scores.items()}


def rows(results: Results) -> list[Merit]:
    return [
        merit("encoders", name, m, inc, [r[m] for task, r in results.items() if task[:2] == (name, inc)])
        for name, encoders in RUNS.items()
        for inc in encoders
        for m in (*DIRECT, *off_line(name), "riv")
    ]


def draw(out: Path) -> list[Path]:
    """Draw nothing, because the result is a table."""
    return []


FIGURE = PaperFigure(
    "encoders",
    "Beyond the paper: every method with encoders from 4096 down to 64 increments; 20 s, filters of 30 ms. rls, bcrls: "
    "forgetting 1, the last value; riv: forgetting 0.99, all samples after 10 s; the others off-line.",
    tasks,
    work,
    rows,
    draw,
)
