"""Bias-compensated least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.exact import ExactEstimator
from pmfid.estimators.least_squares import solve_with_instruments
from pmfid.estimators.results import Columns


@dataclass(frozen=True)
class BCLS(ExactEstimator):
    """Bias-compensated least squares (paper eq. 17 to 32): theta = (sum zeta phi^T)^-1 sum zeta z; see `BCRLS`."""

    method: ClassVar[str] = "bcls"
    instrumental: ClassVar[bool] = True

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return solve_with_instruments(columns)
