"""A lag of the input that is to be found, for methods that are linear in what they find."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pmfid.estimators.results import Columns
from pmfid.types import Floats

#: Step of the difference quotient by the lag [samples].
STEP = 1e-3


def with_lag(columns_at: Callable[[float], Columns], theta: Floats, dt: float) -> Columns:
    """The columns for theta (p,), the last of which is the lag [s], from those at known lags.

    To first order a lag multiplies what the equation's error loses with it; the target counts from the lag at hand, so
    that an iteration ends where this term is zero. The error's change has no noise, and is its own instrument.
    """
    lag, others = max(float(theta[-1]), 0.0), theta[:-1]
    low, high = max(lag - STEP * dt, 0.0), lag + STEP * dt
    below, here, above = (columns_at(value) for value in (low, lag, high))
    change = _error(below, others) - _error(above, others)
    column = change / (high - low)
    phi, zeta = (np.column_stack([side, column]) for side in (here.phi, here.zeta))
    return replace(here, phi=phi, z=here.z + lag * column, zeta=zeta)


def _error(columns: Columns, theta: Floats) -> Floats:
    return np.asarray(columns.z - columns.phi @ theta)
