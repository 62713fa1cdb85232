"""Which encoder a motion needs: the uncertainty of a parameter against the step of the encoder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pmfid.config.axis import Axis
from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError, did_you_mean
from pmfid.estimators.configuration import hold_last_input, like
from pmfid.estimators.edges import EdgeFit
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.results import Fit
from pmfid.fit.free_motion import FreeMotion
from pmfid.fit.machine import Excitation
from pmfid.fit.prediction import predict_fit
from pmfid.fit.problem import ObservedStretch
from pmfid.models.axes import ROTARY
from pmfid.pipeline.drives import DRIVES_FOLLOWED, Drives
from pmfid.pipeline.fitted import make_fit
from pmfid.pipeline.kinds import Progress
from pmfid.pipeline.known import check_numbers_known
from pmfid.pipeline.result import DriveResult
from pmfid.presentation import Presentable, Summary, plain_dict
from pmfid.records.joining import make_even, unbroken
from pmfid.records.record import Record
from pmfid.types import Counts, Floats

#: Parts of a sample in the simulated motion, and positions of the disc for each encoder.
ENCODERS_PARTS = 10
ENCODERS_DRAWS = 3
#: Period of the timer of the edges [s].
ENCODERS_TICK = 1e-6
#: Increments per turn of the encoders for a rotary axis.
ENCODERS_INCREMENTS = (16, 64, 256, 1024, 4096, 16384)
#: Fewest steps in the travel of a linear axis, and decades of the steps.
ENCODERS_LEAST_STEPS = 5.0
ENCODERS_DECADES = 4

#: Travel per turn of a rotary axis [rad].
TURN = 2 * np.pi


@dataclass(frozen=True, eq=False, repr=False)
class EncoderChoice(Presentable):
    """Relative uncertainty of the mass (or another leading parameter) for encoders of several steps.

    Attributes
    ----------
    record : str
    parameter : str
    wanted : float
        Wanted relative uncertainty, one standard deviation.
    own : float
        Relative uncertainty of the estimate from the record itself.
    turn : float or None
        Travel per turn of a rotary axis [rad], or None for a linear axis.
    unit : str
        Unit of the steps.
    steps : ndarray (k,)
        Steps of the encoders, the coarsest first.
    counts, edges : ndarray (k,)
        Relative uncertainty from counts, and from counts with edge times. NaN means that the parameter is unknown.
        Edge times of two masses are not compared, and `edges` is empty.
    notes : tuple of str
    """

    record: str
    parameter: str
    wanted: float
    own: float
    turn: float | None
    unit: str
    steps: Floats
    counts: Floats
    edges: Floats
    notes: tuple[str, ...] = ()

    @property
    def kinds(self) -> dict[str, Floats]:
        """The uncertainties by what the method reads."""
        return {"counts": self.counts} | ({"edge times": self.edges} if self.edges.size else {})

    @property
    def answer(self) -> str:
        """The coarsest sufficient encoder of each kind, as a sentence."""
        needs = []
        for kind, bars in self.kinds.items():
            first = int(np.flatnonzero(np.append(True, ~(bars <= self.wanted)))[-1])
            step = float(self.steps[min(first, bars.size - 1)])
            named = (
                f"steps of {step:.3g} {self.unit}" if self.turn is None else f"{self.turn / step:.0f} increments a turn"
            )
            needs.append(f"{kind} need {'finer steps than these' if first == bars.size else named}")
        return f"to determine {self.parameter} to {100 * self.wanted:.3g} %, {', and '.join(needs)}"

    def summary(self) -> Summary:
        head = f"step [{self.unit}]" if self.turn is None else "increments per turn"
        header, rows = (head, *(f"{kind} [%]" for kind in self.kinds)), []
        for step, *bars in zip(self.steps.tolist(), *(bars.tolist() for bars in self.kinds.values()), strict=True):
            name = f"{step:.3g}" if self.turn is None else f"{self.turn / step:.0f}"
            rows.append((name, *(f"{100 * bar:.2g}" if bar < 1 else "unknown" for bar in bars)))
        title = f"{self.record}: standard deviation of {self.parameter} by encoder"
        return Summary(title, header, rows, remarks=(self.answer, *self.notes))

    def columns(self) -> dict[str, object]:
        return {"step": self.steps, "counts": self.counts, "edges": self.edges}

    def to_dict(self) -> dict[str, object]:
        shown = {"record": self.record, "parameter": self.parameter, "wanted": self.wanted, "own": self.own}
        rest = {"unit": self.unit, "answer": self.answer, "notes": list(self.notes)}
        return plain_dict({**shown, "turn": self.turn, **self.columns(), **rest})


def compare_encoders(
    record: Record,
    axis: Axis,
    wanted: float = 0.01,
    line_error: float = 0.01,
    parameter: str | None = None,
    progress: Progress | None = None,
) -> EncoderChoice:
    """Return the uncertainty of the leading parameter for encoders of several steps.

    The machine is simulated at the estimate from the record, with the input of the record. Each encoder reads the
    simulated motion, with lines that are off by at most `line_error` of a step, and the fits of counts and of edges see
    these readings. The uncertainty is the larger of the reported standard deviation (median) and the true error (root
    mean square) over several positions of the disc.

    Raises UsageError for a value outside its range, and NotIdentifiableError as `identify`.
    """
    kind = Drives()
    if not (0 < wanted < 1 and 0 <= line_error < 0.5):
        raise UsageError(
            "the wanted uncertainty must be above 0 and below 100 %, and the error of the lines below 50 %"
        )
    check_numbers_known(axis, "a comparison of encoders")
    record = replace(unbroken(make_even(record)), ages=None)
    axis = kind.settle_axis(record, axis)
    result = kind.estimate(record, axis)
    names = result.names
    if parameter is not None and parameter not in names:
        raise UsageError(
            f"{parameter!r} is not a parameter; give one of {', '.join(names)}{did_you_mean(parameter, names)}"
        )
    index = result.estimator.equation.leading if parameter is None else names.index(parameter)
    trial, bars = _Trial.make(result, record, axis, line_error), list[tuple[float, ...]]()
    steps = trial.list_steps()
    for number, step in enumerate(steps.tolist()):
        bars.append(trial.compute_uncertainties(step, index))
        if progress is not None:
            progress((number + 1) / steps.size)
    counts, *edges = np.transpose(bars)
    own = float(result.theta_std[index] / abs(result.theta[index]))
    unit = "counts" if record.in_counts else result.estimator.equation.motion.travel
    notes = tuple(_find_limits(trial, own, wanted, names[index]))
    return EncoderChoice(
        record.name, names[index], wanted, own, trial.turn, unit, steps, counts, np.ravel(edges), notes
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """A simulated motion (m,) in `every` parts of each sample, and the methods that read this motion.

    `theta` (p,) are the true parameters, and `u` (n,) is the input. `turn` is the travel per turn of a rotary axis
    [rad]. `line_error` is the largest distance of a line from its place in steps. `missed` is the relative distance of
    the simulated from the recorded motion. `predicted` (p,) are the relative uncertainties of two masses over the step
    of the encoder; it is empty for one mass.
    """

    method: MotionFit
    theta: Floats
    u: Floats
    path: Trajectory
    turn: float | None
    line_error: float
    missed: float
    predicted: Floats

    @classmethod
    def make(cls, result: DriveResult, record: Record, axis: Axis, line_error: float) -> _Trial:
        method, u = make_fit(axis, record), hold_last_input(record.u)
        there = np.ones(u.size, bool) if record.there is None else record.there
        problem = method.problem(u, record.counts, there)
        (stretch,) = problem.stretches
        theta = result.theta[: len(method.names)]
        motion = FreeMotion.make(problem, theta)
        fine = _refine(stretch, ENCODERS_PARTS)
        x, v = motion.simulate(fine, motion.find_start(stretch))
        missed = float(np.std(x[::ENCODERS_PARTS][stretch.drive.row] - stretch.y) / np.std(stretch.y))
        path = Trajectory(np.asarray(np.arange(x.size) * (record.dt / ENCODERS_PARTS)), x, v)
        turn = TURN if method.equation.motion is ROTARY and not record.in_counts else None
        predicted = predict_fit(problem, theta) / problem.resolution if method.equation.elastic else np.zeros(0)
        return cls(method, theta, u, path, turn, line_error, missed, predicted)

    def list_steps(self) -> Floats:
        """Return the steps of the encoders, the coarsest first: powers of 4 per turn, or decimal steps."""
        if self.turn is not None:
            return self.turn / np.array(ENCODERS_INCREMENTS, float)
        largest = np.floor(np.log10(np.ptp(self.path.x) / ENCODERS_LEAST_STEPS))
        return np.outer(10.0 ** (largest - np.arange(ENCODERS_DECADES)), [1.0, 0.3]).ravel()

    def compute_uncertainties(self, step: float, index: int) -> tuple[float, ...]:
        """Return the relative uncertainty of a parameter from counts, and for one mass from counts with edge times."""
        if self.predicted.size:
            return (float(self.predicted[index]) * step,)
        travel = float(np.ptp(self.path.x)) if self.turn is None else self.turn
        lines = max(1, round(travel / step))
        counting = replace(self.method, encoder=Encoder(step))
        timing = like(EdgeFit, counting, lines=None if self.turn is None else lines, tick=ENCODERS_TICK)
        by_counts: list[Fit | None] = []
        by_edges: list[Fit | None] = []
        for seed in range(ENCODERS_DRAWS):
            rng = np.random.default_rng([seed, lines])
            errors = step * self.line_error * rng.uniform(-1.0, 1.0, lines)
            counts, ages = read_edge_times(
                self.path, Lattice(step, step * rng.random(), errors), ENCODERS_PARTS, ENCODERS_TICK
            )
            by_counts.append(_try_fit(counting, self.u, counts))
            # without a fit of the edges, `identify` uses the counts
            by_edges.append(_try_fit(timing, self.u, counts, ages) or by_counts[-1])
        return self._summarise(by_counts, index), self._summarise(by_edges, index)

    def _summarise(self, tried: Sequence[Fit | None], index: int) -> float:
        """Return the larger of the median standard deviation and the root mean square error, relative to the truth.

        The result is NaN if half of the positions of the disc give no fit.
        """
        fits = [fit for fit in tried if fit is not None]
        if 2 * len(fits) <= ENCODERS_DRAWS:
            return float("nan")
        std = np.median([fit.theta_std[index] for fit in fits])
        error = np.sqrt(np.mean([(fit.theta[index] - self.theta[index]) ** 2 for fit in fits]))
        return float(max(std, error) / abs(self.theta[index]))


def _try_fit(method: MotionFit, *record: Floats | Counts) -> Fit | None:
    with suppress(NotIdentifiableError):
        return method.fit(*record)
    return None


def _refine(stretch: ObservedStretch, parts: int) -> ObservedStretch:
    """Return a stretch in parts of its intervals, with an observation at each instant."""
    drive = stretch.drive
    rows = np.arange(drive.step.size * parts + 1, dtype=np.int32)
    fine = Excitation(
        np.repeat(drive.step / parts, parts), np.repeat(drive.u, parts), rows, np.zeros((0, rows.size - 1))
    )
    y, flags = np.interp(rows / parts, drive.row, stretch.y), np.ones(rows.size, bool)
    return ObservedStretch(fine, y, np.full(rows.size, 1 / 12), flags, ~flags, stretch.first)


def _find_limits(trial: _Trial, own: float, wanted: float, parameter: str) -> Iterator[str]:
    """Yield what limits the comparison, as sentences."""
    if own > wanted:
        yield (
            f"the record itself gives {parameter} only to {100 * own:.2g} %, limited by noise, unmodelled effects or "
            "its encoder; a longer or livelier motion helps, another encoder may not"
        )
    if trial.missed > DRIVES_FOLLOWED:
        yield (
            f"the simulated motion differs from the recorded one by {100 * trial.missed:.0f} % of the travel, and the "
            "comparison uses the simulated motion"
        )
    if not trial.predicted.size:
        yield (
            "the deviations contain only the error of the encoder, not noise or unmodelled effects; lines are wrong by "
            f"at most {100 * trial.line_error:g} % of a step, and the timer has ticks of "
            f"{1e6 * ENCODERS_TICK:g} us"
        )
