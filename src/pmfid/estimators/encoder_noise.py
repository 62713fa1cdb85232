"""What an encoder's error makes of the columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import first_order
from pmfid.estimators.base import Estimator
from pmfid.filters.columns import ColumnBuilder
from pmfid.filters.network import LATE_POSITION, SPLIT_FORWARD, VELOCITY, Network, Taps

#: Samples of a response that are in memory at once.
PART = 2**17
#: What the encoder shows of the leading column, at least.
LEAST = 1e-18
#: Frequencies of the gain of an encoder's error, and their decades below the sampling frequency.
FREQUENCIES, DECADES = 4096, 9


def noise_covariance(estimator: Estimator, noise_std: float | None) -> NDArray[np.float64]:
    """(p + 1, p + 1) covariance of the noise of regressors and target: sigma^2 sum g g^T, g the impulse responses of
    the noisy columns. The target has noise only in an equation with known terms of the output.

    noise_std: standard deviation of the position [unit of y]; None: resolution / sqrt(12), as of a quantiser whose
    error is white, which holds from about one count of motion per sample on.
    """
    sigma = estimator.encoder.resolution / np.sqrt(12.0) if noise_std is None else noise_std
    network, columns = estimator._columns
    return np.asarray(sigma**2 * impulse_products(estimator, network, columns[: len(estimator.names) + 1]))


def impulse_products(estimator: Estimator, network: Network, columns: list[Taps]) -> NDArray[np.float64]:
    """(c, c): sum over time of the products of the columns' responses to one wrong position."""
    parts = impulse_responses(estimator, network, columns)
    return np.asarray(sum((g @ g.T for g in parts), start=np.zeros(2 * (len(columns),))))


def impulse_responses(estimator: Estimator, network: Network, columns: list[Taps]) -> Iterator[NDArray[np.float64]]:
    """(c, n) one after the other: the columns' responses to one wrong position, of a low cutoff millions of samples."""
    samples, memories = 4 * estimator.settle_samples, [0.0 for _ in network.stages]
    for first in range(0, samples, PART):
        nodes = [np.zeros(min(PART, samples - first)) for _ in range(network.first)]
        if first == 0:
            nodes[VELOCITY][:2] = np.array([1.0, -1.0]) / estimator.dt  # the mean velocities of one wrong position
            nodes[SPLIT_FORWARD][1:3] = nodes[VELOCITY][:2]
            nodes[LATE_POSITION][1:3] = 0.5
        for k, (source, a, b0, b1) in enumerate(network.stages):
            if source == len(nodes):  # of the simulated motion, which an encoder's error does not reach
                nodes.append(np.zeros_like(nodes[0]))
                continue
            response, memories[k] = first_order(nodes[source], a, b0, b1, memories[k])
            nodes.append(response)
        yield np.array([sum(weight * nodes[node] for node, weight in taps) for taps in columns])


def compute_encoder_floor(estimator: Estimator) -> float:
    """The inverse square of what the encoder shows of the regressor of the highest derivative.

    An error of half a step at every sample, at the frequency that matters most, makes no larger root mean square than
    this: what is beyond is a motion.
    """
    builder = ColumnBuilder(estimator.equation, estimator.spec)
    column = builder.coefficient(estimator.equation.unknown[estimator.equation.leading], "measured")
    gain = np.max(np.abs(frequency_response(estimator, builder.network, column)))
    return float(max(estimator.encoder.resolution / 2 * gain, LEAST) ** -2)  # float32 holds that, too


def frequency_response(estimator: Estimator, network: Network, column: Taps) -> NDArray[np.complex128]:
    """(FREQUENCIES,) of a column to a wrong position, up to half the sampling frequency."""
    late = np.exp(-1j * np.geomspace(np.pi * 10.0**-DECADES, np.pi, FREQUENCIES))
    nodes = [np.zeros(FREQUENCIES, complex) for _ in range(network.first)]
    nodes[VELOCITY] = (1 - late) / estimator.dt
    nodes[SPLIT_FORWARD] = late * nodes[VELOCITY]
    nodes[LATE_POSITION] = (late + late**2) / 2
    for source, a, b0, b1 in network.stages:
        nodes.append((b0 + b1 * late) / (1 - a * late) * nodes[source])
    return np.asarray(sum(weight * nodes[node] for node, weight in column), complex)
