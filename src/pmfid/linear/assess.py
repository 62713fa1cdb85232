"""Does a transfer function explain its records? Fit, residual tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.linear.experiment import Stretch
from pmfid.linear.sensitivity import simulate
from pmfid.linear.solve import Problem, visit

Floats = NDArray[np.float64]

LAGS = 25
#: Normal deviate of the bounds: 99 % of independent residuals lie within.
DEVIATE = 2.576
#: Feedback is called where a correlation with later inputs is beyond the bound by this factor.
CLEAR = 1.5


@dataclass(frozen=True, eq=False)
class Assessment:
    """A model on its records.

    fit: percent, 100 (1 - |y - simulated| / |y - mean y|), initial conditions fitted; simulated, residual: for each
    stretch, on its measured samples; samples: their numbers within
    the record; records: its number. autocorrelation: (LAGS + 1,) of the
    residual, from lag 0; cross: (2 LAGS + 1,) of the residual with the input of `lags` samples before; bounds of both:
    99 % of an independent residual lie within.
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

    @property
    def lags(self) -> NDArray[np.int64]:
        """(2 LAGS + 1,) of `cross`; negative: inputs after the residual, where only feedback correlates them."""
        return np.arange(-LAGS, LAGS + 1)

    @property
    def white(self) -> bool:
        """At most as many correlations beyond the bound as chance explains, four of 25."""
        return int(np.sum(np.abs(self.autocorrelation[1:]) > self.autocorrelation_bound)) <= 3

    @property
    def independent(self) -> bool:
        """The same of the correlation with present and earlier inputs: the model has taken all that is in them."""
        return int(np.sum(np.abs(self.cross[LAGS:]) > self.cross_bound)) <= 3

    @property
    def feedback(self) -> bool:
        """Is the residual correlated with later inputs? Then input and noise are, as a controller does it."""
        return bool(np.max(np.abs(self.cross[:LAGS])) > CLEAR * self.cross_bound)


def assess(problem: Problem, theta: Floats) -> Assessment:
    """theta (p,) in the problem's units."""
    count = len(problem.stretches)
    point = visit(problem, theta, np.zeros((count, problem.structure.n)))
    pairs = zip(problem.stretches, point.initial, strict=True)
    simulated = [
        simulate(problem.structure, theta, initial, stretch, source=0)[stretch.rows] for stretch, initial in pairs
    ]
    measured = [stretch.y[stretch.rows] for stretch in problem.stretches]
    residual = [y - x for y, x in zip(measured, simulated, strict=True)]
    left = sum(float(e @ e) for e in residual)
    whole = sum(float(np.sum((y - np.mean(y)) ** 2)) for y in measured)
    grids = [_on_grid(e, stretch) for e, stretch in zip(residual, problem.stretches, strict=True)]
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
    )


def _on_grid(residual: Floats, stretch: Stretch) -> tuple[Floats, Floats, Floats]:
    """Residual with zeros where nothing is measured, input less its mean, and 1 where there is a residual."""
    filled, there = np.zeros(stretch.grid.size), np.zeros(stretch.grid.size)
    filled[stretch.rows], there[stretch.rows] = residual, 1.0
    u = stretch.inputs[0]
    return filled, u - np.mean(u), there


def _correlations(grids: list[tuple[Floats, Floats, Floats]]) -> tuple[Floats, Floats, tuple[float, float]]:
    count = sum(float(np.sum(there)) for _, _, there in grids)
    power = sum(float(e @ e) for e, _, _ in grids) / count
    input_power = sum(float(np.mean(u**2)) * float(np.sum(there)) for _, u, there in grids) / count
    size = max(power, 1e-300)
    auto = np.array([sum(_lagged(e, e, lag) for e, _, _ in grids) for lag in range(LAGS + 1)]) / count / size
    cross = np.array([sum(_lagged(u, e, lag) for e, u, _ in grids) for lag in range(-LAGS, LAGS + 1)]) / count
    cross = cross / np.sqrt(size * max(input_power, 1e-300))
    u_auto = np.array([sum(_lagged(u, u, lag) for _, u, _ in grids) for lag in range(LAGS + 1)])
    u_auto = u_auto / max(u_auto[0], 1e-300)
    # Ljung (1999, eq. 16.66): the variance of the cross-correlation is the sum of the products of both autocorrelations
    spread = max(1.0 + 2 * float(auto[1:] @ u_auto[1:]), 0.1)
    return auto, cross, (DEVIATE / np.sqrt(count), DEVIATE * float(np.sqrt(spread / count)))


def _lagged(early: Floats, late: Floats, lag: int) -> float:
    """sum early[k - lag] late[k]."""
    if lag < 0:
        return _lagged(late, early, -lag)
    return float(early[: early.size - lag] @ late[lag:]) if lag < early.size else 0.0
