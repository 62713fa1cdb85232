"""Free-run predictions of a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BEYOND
from pmfid.estimators.configuration import check_arrays
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.srivc import make_problem, process_of
from pmfid.fit.free_motion import FreeMotion
from pmfid.fit.problem import ObservedStretch
from pmfid.linear.experiment import Experiment, RecordStretch
from pmfid.linear.responses import simulate
from pmfid.linear.solve import ProcessProblem, visit
from pmfid.types import Counts, Flags, Floats

#: Lengths of the free runs [s]. `FREE_RUN_WORTH` is the smallest ratio of a run to the stretch that determines its
#: start. Shorter or longer records use the same lengths, scaled by powers of ten.
FREE_RUN_HORIZONS = (1.0, 2.0, 5.0, 10.0)
FREE_RUN_WORTH = 2.0
#: Largest number of runs for each horizon.
MOST_RUNS = 200
#: Smallest number of samples for each unknown in the fit of a start.
FREE_RUN_SAMPLES = 4


def rms(signal: Floats) -> float:
    """Return the root mean square of a signal (n,), 0 if it is empty."""
    return float(np.sqrt(np.mean(signal**2))) if signal.size else 0.0


@dataclass(frozen=True)
class Horizon:
    """Errors of free runs of one length.

    Each run lasts `seconds` and starts from the measured motion. `rmse` is the root mean square of the errors [unit of
    the output]. `standstill` is the error of a model that stays at its start [unit of the output].
    """

    seconds: float
    runs: int
    rmse: float
    standstill: float


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A free run of a model in comparison with the record.

    The time t [s], the measured and the simulated output have shape (n,). They belong to the samples `rows` (n,) of the
    record. `read` is the length of the first stretch [s], which determines the start. `encoder` is the root mean square
    error of the encoder alone, or None without an encoder. `notes` are sentences for the user.
    """

    name: str
    rows: NDArray[np.intp]
    t: Floats
    measured: Floats
    simulated: Floats
    read: float
    encoder: float | None
    horizons: tuple[Horizon, ...]
    notes: tuple[str, ...] = ()

    @property
    def error(self) -> Floats:
        """The measured output minus the simulated output (n,)."""
        return self.measured - self.simulated

    @property
    def rmse(self) -> float:
        return rms(self.error)

    @property
    def largest(self) -> float:
        return float(np.max(np.abs(self.error)))

    @property
    def mean(self) -> float:
        """The root mean square error of a model whose output is the mean of the record."""
        return rms(self.measured - np.mean(self.measured))

    @property
    def standstill(self) -> float:
        """The root mean square error of a model that stays at its first position."""
        return rms(self.measured - self.measured[0])

    @property
    def fit(self) -> float | None:
        """The fit, 100 (1 - |y - simulated| / |y - mean y|) [%], or None if the output does not move (Ljung 1999,
        `compare`).
        """
        return 100 * (1 - self.rmse / self.mean) if self.mean > 0 else None

    @property
    def relative(self) -> float | None:
        """The relative error of robot identification, 100 |y - simulated| / |y| [%]. The error depends on the zero
        of the output.
        """
        size = rms(self.measured)
        return 100 * self.rmse / size if size > 0 else None


@np.errstate(all="ignore")  # parameters from a file may overflow, and `finite` checks the result
def drive_run(
    method: MotionFit, theta: Floats, u: Floats, counts: Counts, name: str, there: Flags | None = None
) -> FreeRun:
    """Return the free run of a drive with parameters theta (p,) and input u (n,), started at the first counts of (n,).

    An input of NaN is a gap, after which the run starts again. `there` (n,) marks the counts in use, None all. Raises
    UsageError if the mass is not positive or if the parameters allow no simulation.
    """
    u, counts = check_arrays(u, counts)
    problem = method.problem(u, counts, there)
    stretches = problem.stretches
    _check_motion(method, theta, stretches, name)
    q = problem.start(theta)
    inside = problem.clip_to_bounds(q.copy())
    below = [n for n, value, least in zip(method.names, q, inside, strict=False) if value < least]
    notes = [f"{', '.join(below)} is below zero, and is simulated as zero"] if below else []
    motion = FreeMotion.make(problem, problem.theta(inside))
    pairs = [(one.y, motion.simulate(one)[0]) for one in stretches]
    measured, simulated = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    horizons = measure_horizons(
        u.size * method.dt,
        motion.reads,
        lambda seconds: _restart_simulations(motion, stretches, max(2, round(seconds / method.dt)), method.dt),
    )
    t = np.append(0.0, np.cumsum(np.broadcast_to(method.intervals, u.shape)[:-1]))
    rows = np.concatenate([one.first + one.drive.row for one in stretches])
    first, encoder = method.position(counts)[0], method.encoder.resolution / math.sqrt(12)
    measured, simulated = first + measured, first + simulated
    return finite(FreeRun(name, rows, t[rows], measured, simulated, motion.reads, encoder, horizons, tuple(notes)))


def _check_motion(method: MotionFit, theta: Floats, stretches: Sequence[ObservedStretch], name: str) -> None:
    leading = method.equation.leading
    if not theta[leading] > 0:
        raise UsageError(
            f"{method.names[leading]} = {theta[leading]:g} must be positive to simulate a motion; identify again, from "
            "a record with more motion"
        )
    if not any(np.any(one.drive.u) for one in stretches):
        raise UsageError(f"{name}: the input is zero in the whole record; give a record of a motion")
    if not any(np.ptp(one.y) > 0 for one in stretches):
        raise UsageError(f"{name}: the axis does not move in the whole record; give a record of a motion")


def _restart_simulations(
    motion: FreeMotion, stretches: Sequence[ObservedStretch], samples: int, step: float
) -> list[tuple[Floats, Floats]]:
    """Return the measured and the simulated positions of consecutive runs, each after a lead with a known input."""
    lead, runs = math.ceil(motion.lead / step), []
    for stretch in stretches:
        for first in firsts_of(stretch.drive.step.size + 1, samples):
            begin = max(0, first - lead)
            part = stretch.part(begin, first + samples - 1)
            kept = part.drive.row >= first - begin
            if np.count_nonzero(kept) > 2:
                runs.append((part.y[kept], motion.simulate(part)[0][kept]))
    return runs


def firsts_of(n: int, samples: int) -> list[int]:
    """Return the first samples of consecutive runs of `samples` samples within n samples.

    If the record holds too many runs, the function returns an evenly spread selection.
    """
    firsts = np.arange(0, n - samples + 1, samples)
    return firsts[:: -(-firsts.size // MOST_RUNS)].tolist() if firsts.size else []


def measure_horizons(
    duration: float, read: float, runs: Callable[[float], Sequence[tuple[Floats, Floats]]]
) -> tuple[Horizon, ...]:
    """Return the errors of runs for each horizon.

    A horizon must fit into the `duration` of the record [s]. A horizon must also be several times longer than `read`,
    the stretch [s] that determines the start. `runs` returns the measured and simulated outputs of all runs of a given
    length [s].
    """
    found = []
    least, horizons = FREE_RUN_WORTH * read, FREE_RUN_HORIZONS
    usual = least <= horizons[2] and duration >= horizons[1]
    unit = 1.0 if usual else 10.0 ** math.ceil(math.log10(least))
    for seconds in (unit * one for one in horizons if least <= unit * one <= duration):
        parts = runs(seconds)
        if parts:
            error = np.concatenate([measured - simulated for measured, simulated in parts])
            still = np.concatenate([measured - measured[0] for measured, _ in parts])
            found.append(Horizon(seconds, len(parts), rms(error), rms(still)))
    return tuple(found)


def finite(run: FreeRun) -> FreeRun:
    """Return the run, or raise UsageError if the simulation exceeds the range of numbers."""
    if not np.max(np.abs(run.error)) < BEYOND:
        raise UsageError(
            "the simulated output exceeds the range of floating-point numbers: use the units of parameters, input and "
            "resolution with which the parameters were identified"
        )
    return run


def process_run(method: Estimator, theta: Floats, experiment: Experiment, encoder: float | None) -> FreeRun:
    """Return the free run of a transfer function with parameters theta (p,).

    Each stretch without a gap has its own start. `encoder` is the root mean square error of the encoder alone, or None
    without an encoder.

    Raises UsageError if the transfer function is unstable or if the record has too few samples.
    """
    poles = process_of(method, theta, np.zeros((theta.size, theta.size))).poles
    unstable = poles[poles.real > 0]
    if unstable.size:
        raise UsageError(
            f"the transfer function has a pole at {np.max(unstable.real):+.3g} rad/s, so every free run diverges, even "
            "with exact parameters; compare simulations of the closed loop"
        )
    plain = replace(experiment, reference=None)
    n = poles.size
    read = max(5 / method.cutoff, FREE_RUN_SAMPLES * n * plain.period)
    parts = _simulate_stretches(method, theta, [plain], read)
    horizons = measure_horizons(
        float(plain.times[-1] - plain.times[0]),
        read,
        lambda seconds: _restart_processes(method, theta, plain, read, max(2, round(seconds / plain.period))),
    )
    rows = np.concatenate([stretch.samples for stretch, _ in parts])
    measured = np.concatenate([stretch.y[stretch.rows] for stretch, _ in parts])
    simulated = np.concatenate([output for _, output in parts])
    return finite(FreeRun(plain.name, rows, plain.times[rows], measured, simulated, read, encoder, horizons))


def _simulate_stretches(
    method: Estimator, theta: Floats, experiments: Sequence[Experiment], read: float
) -> list[tuple[RecordStretch, Floats]]:
    """Return each stretch with its simulated output at the measured samples."""
    problem = make_problem(method, experiments)
    scaled = theta / problem.structure.scale(problem.rate)
    first = [_first(stretch, read * problem.rate, problem) for stretch in problem.stretches]
    start = np.zeros((len(first), problem.structure.n))
    starts = visit(replace(problem, stretches=tuple(first)), scaled, start).initial
    with np.errstate(all="ignore"):  # `finite` checks the result
        return [
            (stretch, simulate(problem.structure, scaled, initial, stretch)[stretch.rows])
            for stretch, initial in zip(problem.stretches, starts, strict=True)
        ]


def _first(stretch: RecordStretch, read: float, problem: ProcessProblem) -> RecordStretch:
    """Return the stretch with only the samples that determine its start."""
    early = stretch.rows[stretch.grid.instants[stretch.rows] <= read]
    least = min(stretch.rows.size, problem.structure.n + 1)
    return replace(stretch, rows=early if early.size >= least else stretch.rows[:least])


def _restart_processes(
    method: Estimator, theta: Floats, experiment: Experiment, read: float, samples: int
) -> list[tuple[Floats, Floats]]:
    parts = [_part(experiment, first, first + samples) for first in firsts_of(experiment.u.size, samples)]
    usable = [part for part in parts if np.all(np.isfinite(part.u)) and np.count_nonzero(np.isfinite(part.y)) > 2]
    if not usable:
        return []
    return [(stretch.y[stretch.rows], output) for stretch, output in _simulate_stretches(method, theta, usable, read)]


def _part(experiment: Experiment, first: int, last: int) -> Experiment:
    t = None if experiment.t is None else experiment.t[first:last]
    return replace(experiment, u=experiment.u[first:last], y=experiment.y[first:last], t=t)
