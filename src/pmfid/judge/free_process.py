"""A transfer function against records it was not fitted to, as `free_run` does it for machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.output_error import OE
from pmfid.estimators.srivc import make_problem, process_of
from pmfid.estimators.starts import READ
from pmfid.judge.free_run import FreeRun, finite, firsts_of, measure_horizons
from pmfid.transfer.experiment import Experiment, RecordStretch
from pmfid.transfer.sensitivity import simulate
from pmfid.transfer.solve import ProcessProblem, visit
from pmfid.types import Floats

#: Samples that the start of a stretch is read from, for each of its unknowns, at least.
SAMPLES = 4


def process_run(method: OE, theta: Floats, experiment: Experiment, encoder: float | None) -> FreeRun:
    """The free run of a transfer function with parameters theta (p,); each stretch without a gap has a start of its
    own. encoder: root mean square error that it would leave alone, None: none.

    Raises UsageError for an unstable one, and for a record of too few samples.
    """
    poles = process_of(method, theta, np.zeros((theta.size, theta.size))).poles
    unstable = poles[poles.real > 0]
    if unstable.size:
        raise UsageError(
            f"the transfer function has a pole at {np.max(unstable.real):+.3g} rad/s: a free run of it runs away, "
            "whatever it is worth; compare closed loops"
        )
    plain = replace(experiment, reference=None)
    n = poles.size
    read = max(READ / method.cutoff, SAMPLES * n * plain.period)
    parts = _simulate_stretches(method, theta, [plain], read)
    horizons = measure_horizons(
        float(plain.times[-1] - plain.times[0]),
        read,
        lambda seconds: _restart_simulations(method, theta, plain, read, max(2, round(seconds / plain.period))),
    )
    rows = np.concatenate([stretch.samples for stretch, _ in parts])
    measured = np.concatenate([stretch.y[stretch.rows] for stretch, _ in parts])
    simulated = np.concatenate([output for _, output in parts])
    return finite(FreeRun(plain.name, plain.times[rows], measured, simulated, read, encoder, horizons))


def _simulate_stretches(
    method: OE, theta: Floats, experiments: Sequence[Experiment], read: float
) -> list[tuple[RecordStretch, Floats]]:
    """Each stretch and its simulated output at the measured samples."""
    problem = make_problem(method, experiments)
    scaled = theta / problem.structure.scale(problem.rate)
    first = [_first(stretch, read * problem.rate, problem) for stretch in problem.stretches]
    start = np.zeros((len(first), problem.structure.n))
    starts = visit(replace(problem, stretches=tuple(first)), scaled, start).initial
    with np.errstate(all="ignore"):  # what comes of it is looked at
        return [
            (stretch, simulate(problem.structure, scaled, initial, stretch, source=0)[stretch.rows])
            for stretch, initial in zip(problem.stretches, starts, strict=True)
        ]


def _first(stretch: RecordStretch, read: float, problem: ProcessProblem) -> RecordStretch:
    """The stretch with the samples alone that its start is read from."""
    early = stretch.rows[stretch.grid.instants[stretch.rows] <= read]
    least = min(stretch.rows.size, problem.structure.n + 1)
    return replace(stretch, rows=early if early.size >= least else stretch.rows[:least])


def _restart_simulations(
    method: OE, theta: Floats, experiment: Experiment, read: float, samples: int
) -> list[tuple[Floats, Floats]]:
    parts = [_part(experiment, first, first + samples) for first in firsts_of(experiment.u.size, samples)]
    usable = [part for part in parts if np.all(np.isfinite(part.u)) and np.count_nonzero(np.isfinite(part.y)) > 2]
    if not usable:
        return []
    return [(stretch.y[stretch.rows], output) for stretch, output in _simulate_stretches(method, theta, usable, read)]


def _part(experiment: Experiment, first: int, last: int) -> Experiment:
    t = None if experiment.t is None else experiment.t[first:last]
    return replace(experiment, u=experiment.u[first:last], y=experiment.y[first:last], t=t)
