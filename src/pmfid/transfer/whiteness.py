"""Is a residual white? Its correlations with itself against what chance explains."""

from __future__ import annotations

import numpy as np

from pmfid.types import Floats

LAGS = 25
#: Normal deviate of the bounds: 99 % of independent residuals lie within.
DEVIATE = 2.576


def is_white(error: Floats) -> bool:
    """Whether so few autocorrelations of a residual (n,) are beyond their bounds that chance explains them."""
    power = max(float(error @ error), 1e-300)
    auto = np.array([correlate_at_lag(error, error, lag) for lag in range(1, LAGS + 1)]) / power
    return few_beyond(auto, DEVIATE / float(np.sqrt(max(error.size, 1))))


def few_beyond(correlations: Floats, bound: float) -> bool:
    """Whether chance explains how many of the correlations (k,) are beyond a bound of 99 %."""
    return int(np.sum(np.abs(correlations) > bound)) <= 3


def correlate_at_lag(early: Floats, late: Floats, lag: int) -> float:
    """sum early[k - lag] late[k]."""
    if lag < 0:
        return correlate_at_lag(late, early, -lag)
    return float(early[: early.size - lag] @ late[lag:]) if lag < early.size else 0.0
