"""What an encoder's error makes of the columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from pmfid.estimators.base import Estimator
from pmfid.filters.columns import ColumnBuilder
from pmfid.filters.network import LATE_POSITION, SPLIT_FORWARD, VELOCITY, Network, Taps

#: Frequencies of the gain that an encoder's error meets at most.
FREQUENCIES = 4096


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
    g = impulse_responses(estimator, network, columns)
    return np.asarray(g @ g.T)


def impulse_responses(estimator: Estimator, network: Network, columns: list[Taps]) -> NDArray[np.float64]:
    """(c, n): the columns' responses to one wrong position."""
    samples = 4 * estimator.settle_samples
    nodes = [np.zeros(samples) for _ in range(network.first)]
    nodes[VELOCITY][:2] = np.array([1.0, -1.0]) / estimator.dt  # the mean velocities of one wrong position
    nodes[SPLIT_FORWARD][1:3] = nodes[VELOCITY][:2]
    nodes[LATE_POSITION][1:3] = 0.5
    for source, a, b0, b1 in network.stages:
        nodes.append(lfilter([b0, b1], [1.0, -a], nodes[source]))
    return np.array([sum(weight * nodes[node] for node, weight in taps) for taps in columns])


def shown(estimator: Estimator) -> float:
    """The inverse square of what the encoder shows of the regressor of the highest derivative.

    An error of half a step at every sample, at the frequency that matters most, makes no larger root mean square than
    this: what is beyond is a motion.
    """
    builder = ColumnBuilder(estimator.equation, estimator.spec)
    column = builder.regressors()[estimator.equation.leading]
    (response,) = impulse_responses(estimator, builder.network, [column])
    gain = np.max(np.abs(np.fft.rfft(response, max(FREQUENCIES, 2 * response.size))))
    return float((estimator.encoder.resolution / 2 * gain) ** -2)
