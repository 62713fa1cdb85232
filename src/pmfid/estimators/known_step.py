"""Least squares compensated with the known step of the encoder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator, Columns, inverse_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.filters.network import LATE_POSITION, SPLIT_FORWARD, VELOCITY, Network, Taps


def noise_covariance(estimator: Estimator, noise_std: float | None) -> NDArray[np.float64]:
    """(p + 1, p + 1) covariance of the noise of regressors and target: sigma^2 sum g g^T, g the impulse responses of
    the noisy columns; that of the target is zero but for an equation with known terms of the output.

    noise_std: standard deviation of the position [unit of y]; None: resolution / sqrt(12), as of a quantiser whose
    error is white, which holds from about one count of motion per sample on.
    """
    sigma = estimator.encoder.resolution / np.sqrt(12.0) if noise_std is None else noise_std
    network, columns = estimator._columns
    return np.asarray(sigma**2 * impulse_products(estimator, network, columns[: len(estimator.names) + 1]))


def impulse_products(estimator: Estimator, network: Network, columns: list[Taps]) -> NDArray[np.float64]:
    """(c, c): sum over time of the products of the columns' responses to one wrong position."""
    samples = 4 * estimator.settle_samples
    nodes = [np.zeros(samples) for _ in range(network.first)]
    nodes[VELOCITY][:2] = np.array([1.0, -1.0]) / estimator.dt  # the mean velocities of one wrong position
    nodes[SPLIT_FORWARD][1:3] = nodes[VELOCITY][:2]
    nodes[LATE_POSITION][1:3] = 0.5
    for source, a, b0, b1 in network.stages:
        nodes.append(lfilter([b0, b1], [1.0, -a], nodes[source]))
    g = np.array([sum(weight * nodes[node] for node, weight in taps) for taps in columns])
    return np.asarray(g @ g.T)


@dataclass(frozen=True)
class KnownStep(BatchEstimator):
    """Off-line: theta = (R - n sigma^2 C)^-1 (r - n sigma^2 c), R = sum phi phi^T, r = sum phi z; C and c, that of phi
    and z, from the filters alone.

    noise_std: of the position; None: that of the encoder's step. No instruments are needed and no pre-filter; it fails
    where the noise is not white, below about one count of motion per sample.
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
    """On-line, with forgetting: the same sums, discounted; see `KnownStep`."""

    method: ClassVar[str] = "rknown-step"

    noise_std: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.forgetting_scheme == "constant-trace":
            raise UsageError(
                "constant-trace is not for rknown-step: it forgets nothing at rest, and the noise that is subtracted "
                "for every sample does not come at rest; use exponential or window"
            )
        super().__post_init__()

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, Any]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        noise = noise_covariance(self, self.noise_std)
        return config | {"compensated": 1, "noise": noise[:-1, :-1].tolist(), "target_noise": noise[:-1, -1].tolist()}
