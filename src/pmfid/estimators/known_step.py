"""Least squares compensated with the known step of the encoder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.recursive import RecursiveEstimator, noise_covariance
from pmfid.estimators.results import Columns


@dataclass(frozen=True)
class KnownStep(BatchEstimator):
    """Off-line: theta = (R - n sigma^2 C)^-1 (r - n sigma^2 c), R = sum phi phi^T, r = sum phi z; C and c, that of phi
    and z, from the filters alone.

    noise_std: of the position [unit of y]; None: the value for the encoder's step. No instruments are needed and no
    pre-filter; it fails where the noise is not white, below about one count of motion per sample.
    """

    method: ClassVar[str] = "known-step"

    noise_std: float | None = field(default=None, kw_only=True)

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        noise = columns.z.size * noise_covariance(self, self.noise_std)
        phi = columns.phi / scale
        inverse = inverse_of(phi.T @ phi - noise[:-1, :-1] / np.outer(scale, scale))
        right = phi.T @ columns.z - noise[:-1, -1] / scale
        return inverse @ right / scale, inverse / np.outer(scale, scale)

    def _scores(self, columns: Columns, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        noise = noise_covariance(self, self.noise_std)
        return super()._scores(columns, theta) + noise[:-1, :-1] @ theta - noise[:-1, -1]


@dataclass(frozen=True)
class RKnownStep(RecursiveEstimator):
    """On-line, with forgetting: the same sums, discounted; see `KnownStep`.

    noise_std: standard deviation of the position [unit of y]; None: the value for the encoder's step.
    """

    method: ClassVar[str] = "rknown-step"

    noise_std: float | None = field(default=None, kw_only=True)

    def scheme_refused(self) -> str:
        if self.forgetting_scheme != "constant-trace":
            return super().scheme_refused()
        return (
            "constant-trace is not for rknown-step: it forgets nothing at rest, and the noise that is subtracted "
            "for every sample does not come at rest; use exponential or window"
        )

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        noise = noise_covariance(self, self.noise_std)
        return config | {"compensated": 1, "noise": noise[:-1, :-1].tolist(), "target_noise": noise[:-1, -1].tolist()}
