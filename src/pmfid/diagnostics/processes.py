"""Flags and verdict of a transfer function."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.causality import ResidualStretch, chance_of_feedback, chance_of_response, estimate_residual_noise
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BEYOND
from pmfid.findings import Finding, make_notes
from pmfid.linear.counts import explain_counts
from pmfid.linear.experiment import Experiment, Grid, RecordStretch, transition
from pmfid.linear.order import Search
from pmfid.linear.process import Process
from pmfid.linear.residuals import (
    Noise,
    correlate_at_lag,
    covariance,
    few_beyond,
    fit_noise,
    places,
    prewhiten_problem,
    residual_repeats,
    whiten_columns,
)
from pmfid.linear.responses import companion, simulate
from pmfid.linear.solve import ProcessPoint, ProcessProblem, descend, fix_dead_time, settle, visit
from pmfid.linear.tuning import TUNING as LINEAR_TUNING
from pmfid.types import Floats

#: Number of standard errors above which two values of a parameter are far apart.
PROCESSES_FAR = 2.0
#: Relative decrease of the sum of squares below which a step is unnecessary and a model is judged.
PROCESSES_SETTLED = 1e-6
#: Greatest probability that a record of noise alone passes the test.
NOISE_CHANCE = 1e-2
#: Probability of chance below which the colour of the noise has moved the estimate.
PROCESSES_ELSEWHERE = 1e-3
#: Greatest part of the right models in open loop that a test of unmodelled effects, of feedback, or of the other
#: hold rejects.
FALSE_ALARM = 1e-4
#: Greatest residual that a wrong hold causes. Its unit is the difference between the responses with both holds at
#: their first sample.
WRONG_HOLD = 2.0
#: Relative standard deviation above which a pole is unknown. The relative standard deviation of a real pole is at
#: most half of the limit, because bars of two standard deviations do not cross zero.
PROCESSES_UNKNOWN = 0.4
#: Explained part of the output [%] below which a finding is due.
POOR_FIT = 10.0
#: Size of an outlier in robust standard deviations. `PROCESSES_FEW` is the greatest part of the samples that may be
#: outliers.
FAR_OUTLIER = 10.0
PROCESSES_FEW = 0.01


@dataclass(frozen=True)
class Hold:
    """The findings on the hold of the input.

    `better` says whether a model with the other hold explains the record significantly better. `hidden` says whether
    the record cannot distinguish the holds although a parameter differs between them by many standard errors.
    """

    better: bool = False
    hidden: bool = False


def look_at_hold(problem: ProcessProblem, point: ProcessPoint, noise: Noise | None) -> Hold:
    """Return whether the input has another hold than the configured one, and whether the hold matters.

    `point` is the estimate. `noise` is the colour of the residual without the input. The function reports nothing if
    the spacing of the samples lets no filter whiten the noise. The function also reports nothing if a reference makes
    the sum of squares meaningless.
    """
    from scipy.special import chdtri  # slow to import

    if noise is None or problem.referenced:
        return Hold()
    white = prewhiten_problem(problem, noise)
    if white is problem and noise.coefficients.size:
        return Hold()
    with np.errstate(all="ignore"):
        try:
            mine, other = (_best(part, point.theta, noise) for part in (white, _swap_hold(white)))
            far = _far_apart(mine, other)
        except (np.linalg.LinAlgError, ValueError):
            return Hold()
    samples = sum(stretch.rows.size for stretch in white.stretches)
    gained = samples * np.log(max(mine.cost, 1e-300) / max(other.cost, 1e-300))
    worth = chdtri(1, 2 * FALSE_ALARM)
    return Hold(bool(gained > worth), bool(abs(gained) <= worth and far))


def _far_apart(mine: ProcessPoint, other: ProcessPoint) -> bool:
    """Return whether a parameter differs by more than its standard errors explain."""
    size = np.maximum(np.linalg.norm(mine.zeta, axis=0), 1e-300)
    scaled = mine.zeta / size
    variances = np.diag(np.linalg.inv(scaled.T @ scaled)) / size**2 * mine.cost / mine.error.size
    return bool(np.any((mine.theta - other.theta) ** 2 > PROCESSES_FAR**2 * variances))


def _swap_hold(problem: ProcessProblem) -> ProcessProblem:
    return replace(problem, stretches=tuple(replace(stretch, held=not stretch.held) for stretch in problem.stretches))


def _best(problem: ProcessProblem, theta: NDArray[np.float64], noise: Noise) -> ProcessPoint:
    """Return the point with the least sum of squares near theta (p,), where theta belongs to the problem before
    whitening.
    """
    theta = theta.copy()
    if problem.structure.offset:
        theta[problem.structure.linear - 1] *= float(np.sum(noise.whitener))
    start = visit(problem, theta, np.zeros((len(problem.stretches), problem.structure.n)))
    return descend(problem, start).point


def depends_on_input(problem: ProcessProblem, point: ProcessPoint) -> bool:
    """Return whether the response to the input explains more of the output than chance.

    The initial state and a constant explain their part first.
    """
    first, last = problem.structure.free, problem.structure.free + problem.structure.m + 1
    without = np.r_[point.theta[:first], np.zeros(last - first), point.theta[last:]]
    rest = visit(problem, without, np.zeros_like(point.initial))
    alone = rest.error
    if problem.structure.offset:
        constant = rest.zeta[:, problem.structure.linear - 1]
        alone = alone - constant * float(constant @ alone) / max(float(constant @ constant), 1e-300)
    noise, place = fit_noise(point.error, places(problem)), places(problem)
    both = whiten_columns(noise, np.column_stack([point.error, alone]), place)
    left, whole = (float(np.sum(column**2)) for column in both[noise.coefficients.size :].T)
    return _reduces_residual(whole, left, point.error.size, problem.structure.size)


@dataclass(frozen=True)
class Second:
    """The result of a second examination of an estimate.

    `surplus` says whether one pole and one zero are superfluous, so that the record does not determine them. `moved`
    says whether whitening of the noise shifts the estimate beyond its standard errors (Hausman 1978). A shifted
    estimate has taken noise for dynamics.
    """

    surplus: bool
    moved: bool


def second_look(problem: ProcessProblem, theta: Floats) -> Second:
    """Examine an estimate theta (p,) a second time, for noise of any colour.

    A pole can settle on a resonance of the noise, and then the residual shows no resonance. Therefore the colour comes
    from the residual of a model with one pole less, without the effect of recent inputs.
    """
    if problem.referenced:  # the noise does not correlate with the instruments
        return Second(False, False)
    problem = _begin_at_dead_time(problem, theta)
    structure, least = problem.structure, max(problem.structure.integrators, 1)
    point = visit(problem, theta, np.zeros((len(problem.stretches), structure.n)))
    smaller = replace(structure, n=max(structure.n - 1, least), m=max(structure.m - 1, 0))
    with np.errstate(all="ignore"):
        try:
            rest = (
                point
                if smaller == structure
                else settle(replace(problem, structure=smaller), settled=PROCESSES_SETTLED).point
            )
            noise = estimate_residual_noise(pair_inputs(problem, rest.error), rest.zeta)
            if noise is None:
                return Second(False, False)
            white = prewhiten_problem(problem, noise)
            scale = np.ones(structure.size)
            if structure.offset and white is not problem:
                scale[structure.linear - 1] = float(np.sum(noise.whitener))
            start = visit(white, point.theta * scale, np.zeros((len(white.stretches), structure.n)))
            full = descend(white, start).point
            surplus = structure.n > least and not _reduces_residual(
                settle(replace(white, structure=smaller), settled=PROCESSES_SETTLED).point.cost,
                full.cost,
                point.error.size,
                2,
            )
            return Second(surplus, _exceeds_chance(full.theta / scale - point.theta, covariance(point, problem)))
        except (np.linalg.LinAlgError, ValueError):
            return Second(False, False)


def _begin_at_dead_time(problem: ProcessProblem, theta: Floats) -> ProcessProblem:
    """Return the problem whose fits begin at the dead time in theta (p,), if it is unknown."""
    if problem.structure.latest is None:
        return problem
    structure = replace(problem.structure, dead_time=float(theta[-1]))
    return replace(fix_dead_time(problem, theta)[0], structure=structure)


def _exceeds_chance(difference: Floats, cov: Floats) -> bool:
    """Return whether a difference (p,) is too large for its covariance (p, p)."""
    from scipy.special import chdtri  # slow to import

    size = np.sqrt(np.diagonal(cov))
    scaled = difference / size
    distance = scaled @ np.linalg.pinv(cov / np.outer(size, size), hermitian=True) @ scaled
    return bool(distance > chdtri(difference.size, PROCESSES_ELSEWHERE))


def pair_inputs(problem: ProcessProblem, error: Floats) -> list[ResidualStretch]:
    """Split the residual (N,) into stretches and pair each of them with its inputs."""
    ends = np.cumsum([stretch.rows.size for stretch in problem.stretches])
    parts = zip(problem.stretches, np.split(error, ends[:-1]), strict=True)
    return [ResidualStretch(stretch.inputs, part, stretch.rows) for stretch, part in parts]


def _reduces_residual(whole: float, left: float, samples: int, unknowns: int) -> bool:
    """Return whether a sum of squares falls from `whole` to `left` by more than chance allows for `unknowns`
    parameters.
    """
    from scipy.special import chdtri  # slow to import

    ratio = samples * np.log(max(whole, 1e-300) / max(left, 1e-300))
    return bool(ratio > chdtri(unknowns, NOISE_CHANCE / samples))


@dataclass(frozen=True, eq=False)
class Assessment:
    """The assessment of a model on its records.

    `fit` is 100 (1 - |y - simulated| / |y - mean y|) [%] with fitted initial conditions. `simulated` and `residual`
    hold one array for each stretch, at its measured samples. `samples` are the numbers of the measured samples in the
    record, and `records` are the numbers of the records. `autocorrelation` (residuals_lags + 1,) is the autocorrelation
    of the residual, starting with lag 0. `cross` (2 residuals_lags + 1,) correlates the residual with the input, or
    with the reference if one exists. The bounds of `autocorrelation` and `cross` hold 99 % of the correlations of an
    independent residual. `unmodelled` says whether the present and past input explains the residual. `feedback` says
    whether future inputs explain the residual, because a controller feeds the noise back (`causality.py`). `depends`
    says whether the output depends on the input by more than chance. `hold` is the result of the test of the other
    hold. `repeats` says whether a part of the residual repeats in every period of the input. `second` is the result of
    a second examination.
    """

    fit: float
    simulated: tuple[Floats, ...]
    residual: tuple[Floats, ...]
    samples: tuple[NDArray[np.int64], ...]
    records: tuple[int, ...]
    autocorrelation: Floats
    autocorrelation_bound: float
    cross: Floats
    cross_bound: float
    unmodelled: bool
    feedback: bool
    depends: bool
    hold: Hold
    repeats: bool
    second: Second

    @property
    def lags(self) -> NDArray[np.int64]:
        """The lags (2 residuals_lags + 1,) of `cross`. At negative lags the input follows the residual, and only
        feedback causes correlation.
        """
        return np.arange(-LINEAR_TUNING.residuals_lags, LINEAR_TUNING.residuals_lags + 1)

    @property
    def white(self) -> bool:
        """Whether the residual is white. Chance alone explains up to four of 25 correlations beyond the bound."""
        return few_beyond(self.autocorrelation[1:], self.autocorrelation_bound)

    @property
    def independent(self) -> bool:
        """Whether the model explains all effects of present and past inputs."""
        return not self.unmodelled


def assess(problem: ProcessProblem, theta: Floats, delay: int = 0, resolution: float = 0.0) -> Assessment:
    """Assess theta (p,), given in the problem's units. `delay` is the delay of the inputs in samples.

    A response within every count of a `resolution` leaves rounding alone in the residual. Noise then cannot move the
    estimate. Without such a response, the resolution is 0.

    Raises NotIdentifiableError if the simulated output exceeds the range of numbers.
    """
    second = _look_within(problem, theta, resolution) if resolution else second_look(problem, theta)
    problem, theta = fix_dead_time(problem, theta)
    count = len(problem.stretches)
    point = visit(problem, theta, np.zeros((count, problem.structure.n)))
    pairs = zip(problem.stretches, point.initial, strict=True)
    with np.errstate(all="ignore"):  # the finiteness of the result is checked below
        simulated = [simulate(problem.structure, theta, initial, stretch)[stretch.rows] for stretch, initial in pairs]
    measured = [stretch.y[stretch.rows] for stretch in problem.stretches]
    residual = [y - x for y, x in zip(measured, simulated, strict=True)]
    if not np.max([np.max(np.abs(e), initial=0.0) for e in residual]) < BEYOND:
        raise NotIdentifiableError(
            "the simulated output exceeds the range of floating-point numbers: the records do not identify the "
            "transfer function; excite the process more, or use fewer poles and zeros"
        )
    left = sum(float(e @ e) for e in residual)
    whole = sum(float(np.sum((y - np.mean(y)) ** 2)) for y in measured)
    grids = [_lay_on_grid(e, stretch, -1) for e, stretch in zip(residual, problem.stretches, strict=True)]
    auto, cross, bounds = _correlations(grids)
    return Assessment(
        100 * (1 - float(np.sqrt(left / max(whole, 1e-300)))),
        tuple(simulated),
        tuple(residual),
        tuple(stretch.samples for stretch in problem.stretches),
        tuple(stretch.record for stretch in problem.stretches),
        auto,
        bounds[0],
        cross,
        bounds[1],
        *(_doubts_within(problem, point, resolution) if resolution else _doubts(problem, point, residual, delay)),
        second,
    )


def _doubts(
    problem: ProcessProblem, point: ProcessPoint, residual: list[Floats], delay: int
) -> tuple[bool, bool, bool, Hold, bool]:
    """Return the findings unmodelled, feedback, depends, hold and repeats, in this order.

    The tests take each input at its true time, and not `delay` samples later.
    """
    parts, kept = [], []
    for stretch, error in zip(problem.stretches, residual, strict=True):
        inside = stretch.rows < stretch.grid.size - delay
        kept.append(inside)
        parts.append(ResidualStretch(stretch.inputs[:, delay:], error[inside], stretch.rows[inside]))
    known = point.zeta[np.concatenate(kept)]
    return (
        chance_of_response(parts, known) < FALSE_ALARM,
        chance_of_feedback(parts, known, _direct(problem, point)) < FALSE_ALARM,
        depends_on_input(problem, point),
        look_at_hold(problem, point, estimate_residual_noise(parts, known)),
        residual_repeats(problem, point),
    )


def _look_within(problem: ProcessProblem, theta: Floats, resolution: float) -> Second:
    """Return whether a model with one pole and one zero less than that of theta (p,) stays within every count, too."""
    problem = _begin_at_dead_time(problem, theta)
    structure = problem.structure
    if structure.n <= max(structure.integrators, 1):
        return Second(False, False)
    smaller = replace(problem, structure=replace(structure, n=structure.n - 1, m=max(structure.m - 1, 0)))
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError, ValueError):
        start = settle(smaller, settled=PROCESSES_SETTLED).point
        return Second(explain_counts(smaller, start, resolution) is not None, False)
    return Second(False, False)


def _doubts_within(
    problem: ProcessProblem, point: ProcessPoint, resolution: float
) -> tuple[bool, bool, bool, Hold, bool]:
    """Return the findings of `_doubts` for a response within every count."""
    other, hidden = _swap_hold(problem.without_reference), False
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError, ValueError):
        start = descend(other, visit(other, point.theta, point.initial)).point
        if (within := explain_counts(other, start, resolution)) is not None:
            apart = within[0].theta - point.theta
            hidden = bool(np.any(apart**2 > PROCESSES_FAR**2 * np.diag(within[1])))
    return False, False, depends_on_input(problem, point), Hold(False, hidden), False


def _direct(problem: ProcessProblem, point: ProcessPoint) -> tuple[float, float]:
    """Return the least and the greatest part of the present input that a wrong hold leaves in the residual."""
    a, b, _ = problem.structure.split(point.theta)
    if a.size == 0:  # integrators alone get no allowance for a wrong hold
        return (0.0, 0.0)
    stretch = problem.stretches[0]
    grid = Grid(float(np.median(stretch.grid.steps)), 2)
    change = transition(companion(a), np.eye(a.size)[-1], grid).change
    size = WRONG_HOLD * float(b[: a.size] @ change[: b.size]) * (1.0 if stretch.held else -1.0)
    return (min(0.0, size), max(0.0, size))


def _lay_on_grid(residual: Floats, stretch: RecordStretch, source: int) -> tuple[Floats, Floats, Floats]:
    """Return the residual with zeros at missing samples, the input without its mean, and a mask of the measured
    samples.
    """
    filled, there = np.zeros(stretch.grid.size), np.zeros(stretch.grid.size)
    filled[stretch.rows], there[stretch.rows] = residual, 1.0
    u = stretch.inputs[source]
    return filled, u - np.mean(u), there


def _correlations(grids: list[tuple[Floats, Floats, Floats]]) -> tuple[Floats, Floats, tuple[float, float]]:
    """Return the autocorrelation of the residuals, their correlation with the inputs, and the bounds of both."""
    lags, deviate = LINEAR_TUNING.residuals_lags, LINEAR_TUNING.residuals_deviate

    def correlate(i: int, j: int, first: int) -> Floats:
        return np.array([sum(correlate_at_lag(one[i], one[j], k) for one in grids) for k in range(first, lags + 1)])

    count = sum(float(np.sum(there)) for _, _, there in grids)
    size = max(sum(float(e @ e) for e, _, _ in grids) / count, 1e-300)
    input_power = sum(float(np.mean(u**2)) * float(np.sum(there)) for _, u, there in grids) / count
    auto, u_auto = correlate(0, 0, 0) / count / size, correlate(1, 1, 0)
    cross = correlate(1, 0, -lags) / count / np.sqrt(size * max(input_power, 1e-300))
    u_auto = u_auto / max(u_auto[0], 1e-300)
    # The variance of the cross-correlation is the sum of the products of both autocorrelations (Ljung 1999, eq. 16.66).
    spread = max(1.0 + 2 * float(auto[1:] @ u_auto[1:]), 0.1)
    return auto, cross, (deviate / np.sqrt(count), deviate * float(np.sqrt(spread / count)))


def flags_on(checks: Assessment, process: Process, referenced: bool = False, held: bool = False) -> tuple[str, ...]:
    """Return the names of the status bits.

    - feedback: the input contains the noise, and the method uses no reference.
    - unmodelled: the residual depends on the input, is smaller with the other hold, or repeats with the input.
    - unstable: a pole lies in the right half-plane, and no controller holds it (`held`).
    - uncertain: a pole is unknown or unnecessary, or moves when the noise is whitened.
    - model_spread: the other hold explains the record equally well and moves a parameter beyond its standard error.
    """
    unknown = np.any(np.hypot(*process.poles_std.T) > PROCESSES_UNKNOWN * np.abs(process.poles))
    uncertain = checks.second.surplus or checks.second.moved or bool(unknown)
    found = {
        "feedback": checks.feedback and not referenced,
        "unmodelled": checks.unmodelled or checks.hold.better or checks.repeats,
        "model_spread": checks.hold.hidden and not uncertain,
        "unstable": bool(np.any(process.poles.real > 0)) and not held,
        "uncertain": uncertain,
    }
    return tuple(name for name, holds in found.items() if holds)


#: Without a reference, the estimate is consistent only if the input does not correlate with the noise.
FEEDBACK = (
    "the residual correlates with later inputs, because a controller feeds noise back; the estimate is biased",
    'give [record] reference, and set method = "srivc"',
)
IGNORED = "{method} does not use the reference of the controller; srivc does"
DEPENDENT = (
    "the input explains a part of the residual, and the standard errors leave this error out",
    "try another dead time, more poles or zeros, or another hold",
)
REPEATS = (
    "the residual repeats with the input's period, so the model has an error; the error bars allow for it",
    "search for another structure with pmfid terms",
)
OTHER_HOLD = (
    "the model follows the records better with the other hold of the input, and the hold changes the estimate",
    'set [record] hold = "zoh" if a converter holds the input, "foh" if it changes between samples',
)
UNKNOWN_HOLD = (
    "the record does not show the hold of its input, and the hold moves a parameter beyond its standard error",
    'check [record] hold, "zoh" or "foh", or sample faster',
)
SURPLUS = (
    "a model with one pole and one zero less explains the record as well, so the standard errors are meaningless",
    "use a smaller n and m",
)
MOVED = (
    "a model of the noise moves the estimate beyond its standard errors, so dynamics and noise are confused",
    "record longer, or use a smaller n and m",
)
UNKNOWN_POLE = (
    "the error of a pole may exceed half its size",
    "record longer, excite the process more, or use a smaller n and m",
)
UNSTABLE = ("the transfer function is unstable, so its simulation and the fit are meaningless", "")


def check_known(estimator: Estimator, theta: np.ndarray, cov: np.ndarray, checks: Assessment) -> None:
    """Raise NotIdentifiableError if the covariance is not finite or if the output does not depend on the input."""
    variance = np.diagonal(cov)
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(cov)) and np.all(variance > 0)):
        raise NotIdentifiableError(
            "the records do not determine the transfer function: its uncertainty has no finite value "
            f"({estimator.method}); excite the process more, or use fewer poles and zeros"
        )
    if not checks.depends:
        offset = "" if "offset" in estimator.names else "give [model] offset = true if the output has a constant part, "
        raise NotIdentifiableError(
            f"the input explains the output no better than chance does ({estimator.method}): check columns, dead time "
            f"and outliers, {offset}excite the process more, or use fewer poles and zeros"
        )


def doubts(estimator: Estimator, theta: np.ndarray, std: np.ndarray, checks: Assessment) -> list[Finding]:
    """Return findings on doubtful values in an estimate."""
    residual = np.concatenate(checks.residual)
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    far = int(np.sum(np.abs(residual - np.median(residual)) > FAR_OUTLIER * spread)) if spread > 0 else 0
    found = []
    unknown = [name for name, value, s in zip(estimator.names, theta, std, strict=True) if s > abs(value)]
    if unknown:
        found.append(f"the error may exceed the value of {', '.join(unknown)}; try fewer poles or zeros")
    if 0 < far <= PROCESSES_FEW * residual.size:
        found.append(
            f"{far} samples of the output are far from the others and may decide the estimate: leave them empty"
        )
    if 0 <= checks.fit < POOR_FIT:
        found.append(f"the model explains only {checks.fit:.2g} % of the output")
    if "offset" not in estimator.names and abs(np.mean(residual)) > 0.5 * np.std(residual):
        found.append("the residual has a mean: set [model] offset = true")
    return make_notes("fit", found)


def findings_on(
    experiments: Sequence[Experiment], checks: Assessment, process: Process, flags: tuple[str, ...], expected: bool
) -> list[Finding]:
    """Return the findings of the residual tests, the poles and the records.

    `flags` are the names in the status, as `flags_on` returns them. `expected` says whether the user asked for poles in
    the right half-plane.
    """
    found = [
        Finding(code, *words, severity="doubt" if code in flags else "note")
        for code, holds, words in _list_doubts(checks, process, flags, expected)
        if holds
    ]
    missing = sum(int(np.sum(~np.isfinite(experiment.y))) for experiment in experiments)
    return found + make_notes("missing", [f"{missing} samples of the output are missing"] * bool(missing))


def _list_doubts(
    checks: Assessment, process: Process, flags: tuple[str, ...], expected: bool
) -> tuple[tuple[str, bool, tuple[str, str]], ...]:
    """Return code, truth, and sentence with remedy for each possible finding."""
    second, hold = checks.second, checks.hold
    unstable = bool(np.any(process.poles.real > 0)) and not expected
    return (
        ("feedback", "feedback" in flags, FEEDBACK),
        ("unmodelled", checks.unmodelled, DEPENDENT),
        ("unmodelled", checks.repeats, REPEATS),
        ("unmodelled", hold.better, OTHER_HOLD),
        ("model_spread", hold.hidden and not second.surplus, UNKNOWN_HOLD),
        ("uncertain", second.surplus, SURPLUS),
        ("uncertain", second.moved, MOVED),
        ("uncertain", "uncertain" in flags and not (second.surplus or second.moved), UNKNOWN_POLE),
        ("unstable", unstable, UNSTABLE),
    )


def search_notes(search: Search) -> list[str]:
    """Return notes for the user on the best structure."""
    best, found = search.best, []
    if best.refused:
        found.append(f"pmfid identify refuses all structures tried; the first one: {best.refused}")
    if not best.settled:
        found.append("no fit converged for any structure, so the order comes from unfinished fits")
    if not best.white:
        found.append(
            "the residual of the best structure is not white, even after the whitening filter, so the criterion may "
            "prefer too many poles and zeros; take the smallest structure that fits nearly as well"
        )
    if best.fit < POOR_FIT:
        found.append(f"the best structure explains only {max(best.fit, 0.0):.2g} % of the output, possibly by chance")
    return found
