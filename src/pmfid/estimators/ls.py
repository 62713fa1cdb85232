"""Least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.exact import ExactEstimator
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.results import Columns


@dataclass(frozen=True)
class LS(ExactEstimator):
    """Least squares (paper eq. 17): theta = (sum phi phi^T)^-1 sum phi z, by orthogonal decomposition.

    With `prefilter_zeros`: the biased estimate of the extended model (paper eq. 19 to 21).
    """

    method: ClassVar[str] = "ls"

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        Q, R = np.linalg.qr(columns.phi / scale)
        inverse = inverse_of(R)
        return inverse @ (Q.T @ columns.z) / scale, inverse @ inverse.T / np.outer(scale, scale)
