"""Does a transfer function explain its records? Fit, residual tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.judge.causality import ResidualStretch, estimate_residual_noise, find_feedback, find_unmodelled_response
from pmfid.judge.hold import Hold, look_at_hold
from pmfid.judge.necessity import Second, depends_on_input, second_look
from pmfid.transfer.confidence import residual_repeats
from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.propagate import Grid, transition
from pmfid.transfer.sensitivity import companion, simulate
from pmfid.transfer.solve import ProcessPoint, ProcessProblem, visit
from pmfid.transfer.whiteness import DEVIATE, LAGS, correlate_at_lag, few_beyond
from pmfid.types import Floats

#: The square of a number must not leave the format.
BEYOND = 1e120
#: Part of the right models in open loop that a test of unmodelled effects or of feedback may reject.
FALSE_ALARM = 1e-4
#: A wrong hold puts at most this multiple of the difference of the two responses at their first sample into the
#: residual.
WRONG_HOLD = 2.0


@dataclass(frozen=True, eq=False)
class Assessment:
    """A model on its records.

    fit: percent, 100 (1 - |y - simulated| / |y - mean y|), initial conditions fitted; simulated, residual: for each
    stretch, on its measured samples; samples: their numbers within
    the record; records: its number. autocorrelation: (LAGS + 1,) of the
    residual, from lag 0; cross: (2 LAGS + 1,) of the residual with the input of `lags` samples before, or with the
    reference where there is one; bounds of both: 99 % of an independent residual lie within.
    unmodelled: does the input of now and before explain some of the residual? feedback: do inputs yet to come? Then the
    input has the noise in it, as a controller feeds it back (`causality.py`). depends: does the output depend on the
    input by more than chance? second: would a pole and a zero less do as well, and does the
    colour of the noise move the estimate (`necessity.py`)? hold: would the input with the other hold explain
    more, and does it matter (`hold.py`)? repeats: is some of the residual the same in every period of the input
    (`periods.py`)?
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
    second: Second
    hold: Hold
    repeats: bool

    @property
    def lags(self) -> NDArray[np.int64]:
        """(2 LAGS + 1,) of `cross`; negative: inputs after the residual, where only feedback correlates them."""
        return np.arange(-LAGS, LAGS + 1)

    @property
    def white(self) -> bool:
        """At most as many correlations beyond the bound as chance explains, four of 25."""
        return few_beyond(self.autocorrelation[1:], self.autocorrelation_bound)

    @property
    def independent(self) -> bool:
        """The model has taken all that is in present and earlier inputs."""
        return not self.unmodelled


def assess(problem: ProcessProblem, theta: Floats, delay: int = 0) -> Assessment:
    """theta (p,) in the problem's units; delay: samples by which its inputs are late. Raises NotIdentifiableError
    if the simulated output leaves the range of numbers."""
    count = len(problem.stretches)
    point = visit(problem, theta, np.zeros((count, problem.structure.n)))
    pairs = zip(problem.stretches, point.initial, strict=True)
    with np.errstate(all="ignore"):  # what comes of it is looked at
        simulated = [
            simulate(problem.structure, theta, initial, stretch, source=0)[stretch.rows] for stretch, initial in pairs
        ]
    measured = [stretch.y[stretch.rows] for stretch in problem.stretches]
    residual = [y - x for y, x in zip(measured, simulated, strict=True)]
    if not np.max([np.max(np.abs(e), initial=0.0) for e in residual]) < BEYOND:
        raise NotIdentifiableError(
            "the simulated output leaves the range of numbers: the records do not identify the transfer function; "
            "excite the process more, or use fewer poles and zeros"
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
        *_doubts(problem, point, residual, delay),
    )


def _doubts(
    problem: ProcessProblem, point: ProcessPoint, residual: list[Floats], delay: int
) -> tuple[bool, bool, bool, Second, Hold, bool]:
    """unmodelled, feedback, depends, second, hold, repeats. The input is looked at when it comes, not `delay`
    samples later."""
    parts, kept = [], []
    for stretch, error in zip(problem.stretches, residual, strict=True):
        inside = stretch.rows < stretch.grid.size - delay
        kept.append(inside)
        parts.append(ResidualStretch(stretch.inputs[:, delay:], error[inside], stretch.rows[inside]))
    known = point.zeta[np.concatenate(kept)]
    return (
        find_unmodelled_response(parts, known).chance < FALSE_ALARM,
        find_feedback(parts, known, _direct(problem, point)).chance < FALSE_ALARM,
        depends_on_input(problem, point),
        second_look(problem, point),
        look_at_hold(problem, point, estimate_residual_noise(parts, known)),
        residual_repeats(problem, point),
    )


def _direct(problem: ProcessProblem, point: ProcessPoint) -> tuple[float, float]:
    """How much of the input of now a wrong hold leaves in the residual, at least and at most."""
    a, b, _ = problem.structure.split(point.theta)
    if a.size == 0:  # integrators alone
        return (0.0, 0.0)
    stretch = problem.stretches[0]
    grid = Grid(float(np.median(stretch.grid.steps)), 2)
    change = transition(companion(a), np.eye(a.size)[-1], grid).change
    size = WRONG_HOLD * float(b[: a.size] @ change[: b.size]) * (1.0 if stretch.held else -1.0)
    return (min(0.0, size), max(0.0, size))


def _lay_on_grid(residual: Floats, stretch: RecordStretch, source: int) -> tuple[Floats, Floats, Floats]:
    """Residual with zeros where nothing is measured, input less its mean, and 1 where there is a residual."""
    filled, there = np.zeros(stretch.grid.size), np.zeros(stretch.grid.size)
    filled[stretch.rows], there[stretch.rows] = residual, 1.0
    u = stretch.inputs[source]
    return filled, u - np.mean(u), there


def _correlations(grids: list[tuple[Floats, Floats, Floats]]) -> tuple[Floats, Floats, tuple[float, float]]:
    count = sum(float(np.sum(there)) for _, _, there in grids)
    power = sum(float(e @ e) for e, _, _ in grids) / count
    input_power = sum(float(np.mean(u**2)) * float(np.sum(there)) for _, u, there in grids) / count
    size = max(power, 1e-300)
    auto = np.array([sum(correlate_at_lag(e, e, lag) for e, _, _ in grids) for lag in range(LAGS + 1)]) / count / size
    cross = np.array([sum(correlate_at_lag(u, e, lag) for e, u, _ in grids) for lag in range(-LAGS, LAGS + 1)]) / count
    cross = cross / np.sqrt(size * max(input_power, 1e-300))
    u_auto = np.array([sum(correlate_at_lag(u, u, lag) for _, u, _ in grids) for lag in range(LAGS + 1)])
    u_auto = u_auto / max(u_auto[0], 1e-300)
    # Ljung (1999, eq. 16.66): the variance of the cross-correlation is the sum of the products of both autocorrelations
    spread = max(1.0 + 2 * float(auto[1:] @ u_auto[1:]), 0.1)
    return auto, cross, (DEVIATE / np.sqrt(count), DEVIATE * float(np.sqrt(spread / count)))
