"""From a SPEC.toml to a design or to the next round of a commissioning."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from pmfid.design.problem.result import Design
from pmfid.design.search.campaign import Campaign, campaign
from pmfid.design.search.solver import solve
from pmfid.design.trial.appraisal import Appraisal, appraise
from pmfid.design.trial.calibration import DesignedRun
from pmfid.design.trial.sequential import Commissioning, redesign, sequential, simulated_experiment
from pmfid.errors import UsageError
from pmfid.session.config import Axis, EstimatorConfig
from pmfid.session.design_spec import Spec, make_problem
from pmfid.session.model_config import ModelConfig
from pmfid.session.record_config import EncoderConfig
from pmfid.session.records import read_record

__all__ = ["read_run", "run_appraisal", "run_campaign", "run_commissioning", "run_design"]

#: (starts done, starts in all, best value so far)
Progress = Callable[[int, int, float], None]


def run_design(
    spec: Spec, *, workers: int = 1, certify: float | None = None, progress: Progress | None = None
) -> Design:
    """The design that a specification asks for; certify: seconds for a proved bound, None: none. Raises as `solve`."""
    return solve(
        make_problem(spec),
        spec.experiment.criterion,
        combination=spec.experiment.weights,
        starts=spec.search.starts,
        seed=spec.search.seed,
        workers=workers,
        certify=certify,
        progress=progress,
    )


def run_campaign(spec: Spec, motions: int) -> Campaign:
    """A campaign of at most `motions` motions that are the most informative together. Raises as `campaign`."""
    return campaign(
        make_problem(spec),
        spec.experiment.criterion,
        motions=motions,
        combination=spec.experiment.weights,
        starts=spec.search.starts,
        seed=spec.search.seed,
    )


def run_appraisal(spec: Spec, design: Design) -> Appraisal:
    """A design of the specification compared with the standard inputs."""
    return appraise(design, spec.experiment.weights, spec.search.seed)


def run_commissioning(
    spec: Spec,
    runs: Sequence[DesignedRun],
    wanted: Mapping[str, float],
    truth: Mapping[str, float] | None = None,
    rounds: int = 10,
) -> Commissioning:
    """The estimate from the runs, and the next design; with the truth {name: value}, all rounds on a simulated axis.

    Raises UsageError for a truth with names that the drive does not have, and as `sequential` and `redesign` do.
    """
    problem = make_problem(spec)
    how = {"criterion": spec.experiment.criterion, "combination": spec.experiment.weights}
    search = {"starts": spec.search.starts, "seed": spec.search.seed}
    if truth is None:
        return redesign(problem, runs, wanted, **how, **search)  # type: ignore[arg-type]
    unknown = [name for name in truth if name not in problem.nominal]
    if unknown or runs:
        raise UsageError(
            f"{unknown[0]} is no parameter of the drive, which has {', '.join(problem.nominal)}"
            if unknown
            else "give recorded runs, or the truth for a simulation, not both"
        )
    experiment = simulated_experiment(problem, truth, np.random.default_rng(spec.search.seed))
    return sequential(problem, experiment, wanted, rounds=rounds, **how, **search)  # type: ignore[arg-type]


def read_run(spec: Spec, path: Path) -> DesignedRun:
    """A recorded run, columns as [record] says (without it: t, u, counts). Raises UsageError as `read_record` does."""
    resolution = spec.encoder.resolution
    if resolution is None:
        raise UsageError(f"{path}: [encoder] has no resolution; give the travel per count of the record in m")
    axis = Axis(
        record=spec.record,
        encoder=EncoderConfig(resolution=resolution),
        model=ModelConfig(input_gain=spec.drive.input_gain),
        estimator=EstimatorConfig(cutoff=1.0),
    )
    record = read_record(path, axis)
    return DesignedRun(record.u, np.asarray(record.counts * record.resolution, float), record.dt)
