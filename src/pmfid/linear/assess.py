"""Does a transfer function explain its records? Fit, residual tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.special import chdtri

from pmfid.errors import NotIdentifiableError
from pmfid.linear.experiment import Stretch
from pmfid.linear.sensitivity import simulate
from pmfid.linear.solve import Problem, visit

Floats = NDArray[np.float64]

LAGS = 25
#: The square of a number must not leave the format.
BEYOND = 1e120
#: Normal deviate of the bounds: 99 % of independent residuals lie within.
DEVIATE = 2.576
#: Lags of the predictions of residual and input from their own past, and of the test for feedback.
OWN_PAST, AHEAD = 30, 10
#: Feedback is called where so few open loops would have such correlations with later inputs.
FALSE_FEEDBACK = 1e-3


@dataclass(frozen=True, eq=False)
class Assessment:
    """A model on its records.

    fit: percent, 100 (1 - |y - simulated| / |y - mean y|), initial conditions fitted; simulated, residual: for each
    stretch, on its measured samples; samples: their numbers within
    the record; records: its number. autocorrelation: (LAGS + 1,) of the
    residual, from lag 0; cross: (2 LAGS + 1,) of the residual with the input of `lags` samples before, or with the
    reference where there is one; bounds of both: 99 % of an independent residual lie within.
    feedback: is what is new in the input correlated with what was new in the residual before? Then the input has the
    noise in it, as a controller feeds it back. What each adds to its own past is compared (Haugh 1976): a model that is
    too small leaves traces of the input in the residual, but none of inputs yet to come.
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
    feedback: bool

    @property
    def lags(self) -> NDArray[np.int64]:
        """(2 LAGS + 1,) of `cross`; negative: inputs after the residual, where only feedback correlates them."""
        return np.arange(-LAGS, LAGS + 1)

    @property
    def white(self) -> bool:
        """At most as many correlations beyond the bound as chance explains, four of 25."""
        return _few_beyond(self.autocorrelation[1:], self.autocorrelation_bound)

    @property
    def independent(self) -> bool:
        """The same of the correlation with present and earlier inputs: the model has taken all that is in them."""
        return _few_beyond(self.cross[LAGS:], self.cross_bound)


def is_white(error: Floats) -> bool:
    """Whether so few autocorrelations of a residual (n,) are beyond their bounds that chance explains them."""
    power = max(float(error @ error), 1e-300)
    auto = np.array([_lagged(error, error, lag) for lag in range(1, LAGS + 1)]) / power
    return _few_beyond(auto, DEVIATE / float(np.sqrt(max(error.size, 1))))


def _few_beyond(correlations: Floats, bound: float) -> bool:
    return int(np.sum(np.abs(correlations) > bound)) <= 3


def assess(problem: Problem, theta: Floats, delay: int = 0) -> Assessment:
    """theta (p,) in the problem's units; delay: by so many samples its inputs are late. Raises NotIdentifiableError
    where the simulated output leaves the range of numbers."""
    count = len(problem.stretches)
    point = visit(problem, theta, np.zeros((count, problem.structure.n)))
    pairs = zip(problem.stretches, point.initial, strict=True)
    simulated = [
        simulate(problem.structure, theta, initial, stretch, source=0)[stretch.rows] for stretch, initial in pairs
    ]
    measured = [stretch.y[stretch.rows] for stretch in problem.stretches]
    residual = [y - x for y, x in zip(measured, simulated, strict=True)]
    if not max(float(np.max(np.abs(e), initial=0.0)) for e in residual) < BEYOND:
        raise NotIdentifiableError(
            "the simulated output leaves the range of numbers: the records do not identify the transfer function; "
            "excite the process more, or use fewer poles and zeros"
        )
    left = sum(float(e @ e) for e in residual)
    whole = sum(float(np.sum((y - np.mean(y)) ** 2)) for y in measured)
    grids = [_on_grid(e, stretch, -1) for e, stretch in zip(residual, problem.stretches, strict=True)]
    looped = [_on_grid(e, stretch, 0) for e, stretch in zip(residual, problem.stretches, strict=True)]
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
        _fed_back(looped, delay + (0 if all(stretch.held for stretch in problem.stretches) else 1)),
    )


def _on_grid(residual: Floats, stretch: Stretch, source: int) -> tuple[Floats, Floats, Floats]:
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
    auto = np.array([sum(_lagged(e, e, lag) for e, _, _ in grids) for lag in range(LAGS + 1)]) / count / size
    cross = np.array([sum(_lagged(u, e, lag) for e, u, _ in grids) for lag in range(-LAGS, LAGS + 1)]) / count
    cross = cross / np.sqrt(size * max(input_power, 1e-300))
    u_auto = np.array([sum(_lagged(u, u, lag) for _, u, _ in grids) for lag in range(LAGS + 1)])
    u_auto = u_auto / max(u_auto[0], 1e-300)
    # Ljung (1999, eq. 16.66): the variance of the cross-correlation is the sum of the products of both autocorrelations
    spread = max(1.0 + 2 * float(auto[1:] @ u_auto[1:]), 0.1)
    return auto, cross, (DEVIATE / np.sqrt(count), DEVIATE * float(np.sqrt(spread / count)))


def _fed_back(grids: list[tuple[Floats, Floats, Floats]], first: int) -> bool:
    """Haugh's test on the residuals and the inputs of all stretches. first: of the lags of inputs that no output can
    know yet; a held input that begins with it is one."""
    count = sum(float(np.sum(there)) for _, _, there in grids)
    if count < 4 * OWN_PAST:
        return False
    residuals, inputs = _innovations([e for e, _, _ in grids]), _innovations([u for _, u, _ in grids])
    power = np.sqrt(sum(float(e @ e) for e in residuals) * sum(float(w @ w) for w in inputs))
    pairs = list(zip(residuals, inputs, strict=True))
    ahead = np.array([sum(_lagged(e, w, lag) for e, w in pairs) for lag in range(first, first + AHEAD)])
    return bool(count * np.sum((ahead / max(power, 1e-300)) ** 2) > chdtri(ahead.size, FALSE_FEEDBACK))


def _innovations(signals: list[Floats]) -> list[Floats]:
    """What is new in the signals: their errors of linear prediction from their own past (Yule and Walker)."""
    auto = np.array([sum(_lagged(x, x, lag) for x in signals) for lag in range(OWN_PAST + 1)])
    auto[0] = auto[0] * (1 + 1e-9) + 1e-300
    past = solve_toeplitz(auto[:-1], auto[1:])
    return [np.asarray(lfilter(np.r_[1.0, -past], [1.0], x)) for x in signals]


def _lagged(early: Floats, late: Floats, lag: int) -> float:
    """sum early[k - lag] late[k]."""
    if lag < 0:
        return _lagged(late, early, -lag)
    return float(early[: early.size - lag] @ late[lag:]) if lag < early.size else 0.0
