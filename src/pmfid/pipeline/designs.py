"""The settings in SPEC.toml, and designs of an input for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from pmfid.config.axis import Axis, EstimatorConfig
from pmfid.config.model import ModelConfig
from pmfid.config.record import EncoderConfig, RecordConfig
from pmfid.config.toml_file import FileSection, load_sections
from pmfid.design.appraisal import Appraisal, appraise
from pmfid.design.calibration import DesignedRun
from pmfid.design.problem import PROBLEM_MOST, Design, Limits, Problem, parameters_of
from pmfid.design.ranking import rank
from pmfid.design.rounds import Commissioning, redesign, sequential, simulated_experiment
from pmfid.design.solver import Progress, solve
from pmfid.errors import UsageError, did_you_mean
from pmfid.models.drive import Drive
from pmfid.records.joining import make_even
from pmfid.records.record import read_record

Criterion = Literal["trace", "D", "A", "E", "ME", "c"]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Part = Annotated[float, Field(ge=0, lt=1)]
# The type of tuples is not strict, because TOML has lists where a frozen object needs a tuple.
Pair = Annotated[tuple[float, float], Field(strict=False)]
Names = Annotated[tuple[str, ...], Field(strict=False)]


class DriveSpec(FileSection):
    """[drive]: the nominal values of mass x'' + viscous_friction x' + coulomb_friction sign(x') + offset =
    input_gain u.

    Further keys are the parameters of a spring ("stiffness"), a "dead_time" or a "lag" of the input, or of a second
    mass, by their names in `Drive`. A spring without an offset has the offset 0.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]

    input_gain: Positive = Field(description="the force in N per unit of u, for example 2.0")
    body: Literal["rigid", "two-mass"] = Field("rigid", description='"two-mass" for a load on a spring')
    viscous_friction: NotNegative = Field(description="the viscous friction in N s/m, of the motor if there is a load")
    coulomb_friction: NotNegative = Field(description="the Coulomb friction in N, of the motor if there is a load")

    @property
    def drive(self) -> Drive:
        """The drive of the keys."""
        further = self.__pydantic_extra__
        spring = self.body == "rigid" and "stiffness" in further
        drive = Drive(self.input_gain, "offset" in further or spring, spring=spring, body=self.body)
        drive = replace(drive, dead_time="estimate") if "dead_time" in further else drive
        return replace(drive, lag="estimate") if "lag" in further else drive

    @property
    def nominal(self) -> dict[str, float]:
        """The nominal values of the parameters of the drive."""
        own = {"viscous_friction": self.viscous_friction, "coulomb_friction": self.coulomb_friction}
        return ({"offset": 0.0} if self.drive.spring else {}) | self.__pydantic_extra__ | own

    @model_validator(mode="after")
    def _complete(self) -> Self:
        names, given = parameters_of(self.drive), self.nominal
        for name in names:
            if name not in given:
                raise ValueError(f"{name} is missing; give the value as near as it is known")
        for name in given:
            if name not in names:
                raise ValueError(f"{name} is no parameter of this drive{did_you_mean(name, names)}; leave {name} out")
        return self


class EncoderSpec(FileSection):
    """[encoder]: the measurement of the position."""

    resolution: Positive | None = Field(None, description="the travel in m per count, for example 22.75e-6")
    noise_std: Positive | None = Field(
        None, description="the standard deviation of the position in m; without it, resolution / sqrt(12)"
    )
    samples_per_interval: int = Field(
        1, ge=1, description="the number of position samples in each interval of the input"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.resolution is None and self.noise_std is None:
            raise ValueError("resolution and noise_std are both missing; give resolution, the travel per count in m")
        return self


class ExperimentSpec(FileSection):
    """[experiment]: the unknown parameters, and the criterion of a design."""

    unknown: Names = Field(min_length=1, description='the parameters to be found, for example ["mass"]')
    nuisance: Names = Field((), description="parameters that are unknown as well but of no interest")
    criterion: Criterion = Field(
        "D",
        description="trace (of the information), D, A (trace of the inverse), E, ME (condition) or c (one combination)",
    )
    weights: dict[str, float] = Field({}, description="the combination for criterion c, for example {mass = 1.0}")
    scaled: bool = Field(True, description="true to divide the parameters by their nominal values in the criterion")


class MotionSpec(FileSection):
    """[motion]: start, end and duration of the motion, which is always forward without other `directions`."""

    duration: Positive = Field(le=1e6, description="the length of the motion in s, at most 1e6")
    intervals: int = Field(ge=1, description="the number of intervals of constant input, at least 1")
    start: float = Field(0.0, description="the position in m at the start")
    start_velocity: float = Field(0.0, description="the velocity in m/s at the start")
    end: float | None = Field(None, description="the position in m at the end, or leave the key out if the end is free")
    end_velocity: float | None = Field(
        None, description="the velocity in m/s at the end, 0.0 for rest, or leave the key out if the end is free"
    )
    end_tolerance: Pair = Field(
        (0.0, 0.0), description="[position, velocity], the largest permitted deviation at the end in m and m/s"
    )
    directions: Annotated[tuple[int, ...], Field(strict=False)] = Field(
        (), description="1 forward, -1 backward or 0 at rest, for each interval"
    )


class LimitsSpec(FileSection):
    """[limits]: bounds of the machine. A single number b stands for [-b, b]."""

    input: Positive | Pair | None = Field(None, description="the largest input in its unit, or [lowest, highest]")
    input_rate: Positive | None = Field(None, description="the largest change of the input per s")
    position: Pair | None = Field(None, description="[lowest, highest] position in m")
    velocity: Positive | Pair | None = Field(None, description="the largest velocity in m/s, or [lowest, highest]")
    acceleration: Positive | Pair | None = Field(
        None, description="the largest acceleration in m/s^2, or [lowest, highest]"
    )
    jerk: Positive | None = Field(None, description="the largest jerk in m/s^3")
    energy: Positive | None = Field(None, description="the largest integral of the squared input over time")
    rms: Positive | None = Field(None, description="the largest permitted root-mean-square value of the input")
    min_speed: NotNegative = Field(
        0.0,
        description="the lowest permitted speed in m/s while the axis moves; with 0.0 the axis may stop on the way, "
        "and the model is wrong at standstill",
    )

    @model_validator(mode="after")
    def _limits(self) -> Self:
        for name, value in self.model_dump(exclude_none=True).items():
            if np.max(np.abs(value)) > PROBLEM_MOST:
                raise ValueError(
                    f"{name} = {value!r} limits nothing; leave the limit out, or give the limit of the machine"
                )
        return self


class SearchSpec(FileSection):
    """[search]: the effort of the search."""

    starts: int = Field(20, ge=1, le=1_000_000, description="the number of random starts, at most a million")
    seed: int = Field(0, ge=0, lt=2**63, description="a whole number, at least 0 and below 2**63")


#: Columns of a recorded run, unless SPEC.toml names others.
RECORD = RecordConfig(input="u", output="counts", output_kind="counts", time="t")


class Spec(FileSection):
    """All sections of SPEC.toml."""

    drive: DriveSpec = Field(description="a section with input_gain, mass, viscous_friction and coulomb_friction")
    encoder: EncoderSpec = Field(description="a section with the resolution")
    experiment: ExperimentSpec = Field(description="a section that names the unknown parameters")
    motion: MotionSpec = Field(description="a section with at least duration and intervals")
    limits: LimitsSpec = Field(default=LimitsSpec(), description="a section of limits")
    record: RecordConfig = Field(default=RECORD, description="a section that names the columns of recorded runs")
    prior: dict[str, Positive] = Field(default={}, description="a section of standard deviations of parameters")
    robust: dict[str, Part] = Field(default={}, description="a section of relative errors of nominal values")
    search: SearchSpec = Field(default=SearchSpec(), description="a section with starts and seed")


def load_spec(path: Path, overrides: Mapping[str, object] | None = None) -> Spec:
    """Read and validate a SPEC.toml.

    The dotted keys of `overrides`, such as {"experiment.criterion": "trace"}, replace the file's values. An override of
    None has no effect. Raises UsageError with all problems if the file cannot be read or a value is not allowed.
    """
    return load_sections(Spec, path, overrides, "a SPEC.toml")


def make_problem(spec: Spec) -> Problem:
    """Return the design problem of a specification. Raises UsageError if its parts contradict each other."""
    nominal = spec.drive.nominal
    experiment, motion = spec.experiment, spec.motion
    noise = spec.encoder.noise_std
    names = (*experiment.unknown, *experiment.nuisance)
    return Problem(
        drive=spec.drive.drive,
        nominal=nominal,
        unknown=experiment.unknown,
        nuisance=experiment.nuisance,
        horizon=motion.duration,
        intervals=motion.intervals,
        limits=Limits(**spec.limits.model_dump()),
        resolution=spec.encoder.resolution,
        noise_variance=None if noise is None else noise**2,
        start=(motion.start, motion.start_velocity),
        end=(motion.end, motion.end_velocity),
        end_tolerance=motion.end_tolerance,
        samples_per_interval=spec.encoder.samples_per_interval,
        prior=_prior(spec.prior, names),
        scaled=experiment.scaled,
        directions=motion.directions,
        scenarios=_scenarios(spec.robust, nominal),
        combination=experiment.weights,
    )


def _prior(stds: Mapping[str, float], names: tuple[str, ...]) -> np.ndarray | None:
    """Return the information matrix (p, p) of independent standard deviations."""
    others = [name for name in stds if name not in names]
    if others:
        raise UsageError(
            f"[prior] {others[0]} is none of the unknown parameters, which are {', '.join(names)}: leave "
            f"{others[0]} out"
        )
    return np.diag([stds[name] ** -2.0 if name in stds else 0.0 for name in names]) if stds else None


def _scenarios(robust: Mapping[str, float], nominal: Mapping[str, float]) -> tuple[dict[str, float], ...]:
    """Return the nominal values at every corner of the box that the relative errors span."""
    wrong = {name: part for name, part in robust.items() if part > 0}
    corners = product(*((1 - part, 1 + part) for part in wrong.values())) if wrong else ()
    return tuple(
        {name: nominal.get(name, 0.0) * part for name, part in zip(wrong, corner, strict=True)} for corner in corners
    )


def run_design(spec: Spec, *, certify: float | None = None, progress: Progress | None = None) -> Design:
    """Return the design for a specification.

    `certify` is the time limit [s] for a proved bound, or None for no bound. Raises the errors of `solve`.
    """
    return solve(
        make_problem(spec),
        spec.experiment.criterion,
        starts=spec.search.starts,
        seed=spec.search.seed,
        certify=certify,
        progress=progress,
    )


#: A design with the standard inputs: an appraisal, or a ranking of drives without a linear equation.
Comparison = Appraisal | dict[str, Design]


def compare(spec: Spec, design: Design) -> Comparison:
    """Compare a design for the specification with the standard inputs, if its drive has a linear equation."""
    return appraise(design, spec.search.seed) if design.problem.linear else {"design": design}


def run_comparison(spec: Spec, *, certify: float | None = None, progress: Progress | None = None) -> Comparison:
    """Return the design for a specification in comparison with the standard inputs.

    `certify` is that of `run_design`. Raises the errors of `solve` and `rank`.
    """
    problem = make_problem(spec)
    if problem.linear:
        return compare(spec, run_design(spec, certify=certify, progress=progress))
    return rank(problem, spec.experiment.criterion, seed=spec.search.seed, progress=progress)


def run_commissioning(
    spec: Spec,
    runs: Sequence[DesignedRun],
    wanted: Mapping[str, float],
    truth: Mapping[str, float] | None = None,
    rounds: int = 10,
) -> Commissioning:
    """Return the estimate from the runs and the next design.

    With the true parameters `truth`, all rounds run on a simulated axis.

    Raises UsageError if `truth` contains a name that the drive does not have, and the errors of `sequential` and
    `redesign`.
    """
    problem = make_problem(spec)
    criterion, starts, seed = spec.experiment.criterion, spec.search.starts, spec.search.seed
    if truth is None:
        return redesign(problem, runs, wanted, criterion=criterion, starts=starts, seed=seed)
    unknown = [name for name in truth if name not in problem.nominal]
    if unknown or runs:
        raise UsageError(
            f"{unknown[0]} is not a parameter of the drive, which has {', '.join(problem.nominal)}"
            if unknown
            else "recorded runs and --truth exclude each other: drop one of them"
        )
    experiment = simulated_experiment(problem, truth, np.random.default_rng(seed))
    return sequential(problem, experiment, wanted, criterion=criterion, rounds=rounds, starts=starts, seed=seed)


def read_run(spec: Spec, path: Path) -> DesignedRun:
    """Read a recorded run with the columns that [record] names, by default t, u and counts.

    Raises UsageError as `read_record` does.
    """
    resolution = spec.encoder.resolution
    if resolution is None:
        raise UsageError(f"{path}: [encoder] has no resolution; give the travel per count of the record in m")
    axis = Axis(
        record=spec.record,
        encoder=EncoderConfig(resolution=resolution),
        model=ModelConfig(input_gain=spec.drive.input_gain),
        estimator=EstimatorConfig(cutoff=1.0),
    )
    record = make_even(read_record(path, axis))
    return DesignedRun(record.u, np.asarray(record.counts * record.resolution, float), record.dt)
