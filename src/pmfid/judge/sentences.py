"""What the numbers of the model checks say, in sentences."""

from __future__ import annotations

import numpy as np

from pmfid.estimators.difference import rms
from pmfid.estimators.least_squares import long_run_covariance
from pmfid.judge.balance import Balance, Binned
from pmfid.judge.correlations import correlations
from pmfid.models.axes import Units
from pmfid.models.equation import COULOMB_BACKWARD, COULOMB_FORWARD, OFFSET

#: Standard deviations from which on a difference is taken for real: there are many bins and lags to choose from.
SIGNIFICANT = 4.5
#: A force that is real but a smaller part of the model's friction is not worth a warning.
RELEVANT_FORCE = 0.03
#: The same for a correlated part of the residual, as a part of the input force.
RELEVANT_PART = 0.005
#: Fit of the velocity [%] below which the model does not follow.
GOOD_FIT = 90.0
#: A velocity error is the model's from this multiple of the encoder's own error on.
ABOVE_ENCODER = 3.0
#: Correlation at lags that the filter no longer explains.
CORRELATED = 0.2
#: Filter time constants after which the filter alone leaves no correlation.
FILTER_LAGS = 5.0


def simulation_sentence(balance: Balance) -> str:
    """How well the simulated velocity follows, and how far the position drifts."""
    error = rms(balance.measured - balance.simulated)
    text = f"Fit of the simulated velocity: {balance.fit:.1f} %. "
    if balance.fit < GOOD_FIT and error > ABOVE_ENCODER * balance.encoder_noise:
        text += "Look here: the model does not follow the measured motion, beyond what the encoder explains. "
    elif balance.fit < GOOD_FIT:
        text += "The encoder's own error accounts for what is missing. "
    else:
        text += "The model follows the measured motion. "
    far, travel = float(np.max(np.abs(balance.drift))), float(np.ptp(balance.position))
    return text + (
        f"The simulated position departs by up to {far:.2g} m, {100 * far / max(travel, 1e-300):.2g} % of the travel; "
        "it adds up every error of the velocity and nothing calls it back."
    )


def residual_sentence(balance: Balance) -> str:
    """Does the residual depend on velocity, or on position; is a constant force left?"""
    causes = {
        "velocity": "friction is not Coulomb plus viscous, or its parameters are off",
        "position": "a cogging force, a spring, a slope or friction that varies along the travel is not in the model",
    }
    sentences = [
        _dependence(balance, found, name, causes[name])
        for name, found in (("velocity", balance.by_velocity), ("position", balance.by_position))
    ]
    return " ".join([*sentences, *_constant(balance)])


def _dependence(balance: Balance, found: Binned, name: str, cause: str) -> str:
    size = f"{found.change:.2g} N, {100 * found.change / balance.friction_size:.2g} % of the model's friction"
    if found.score <= SIGNIFICANT:
        return f"No dependence on {name} is beyond chance (the means differ by {size})."
    if found.change < RELEVANT_FORCE * balance.friction_size:
        return f"The residual hardly changes with {name} (by {size})."
    return f"Look here: the residual changes with {name} by {size}: {cause}."


def _constant(balance: Balance) -> list[str]:
    mean = float(balance.residual.mean())
    error = np.sqrt(long_run_covariance(balance.residual[:, None] - mean, balance.lags)[0, 0]) / balance.t.size
    if abs(mean) < max(SIGNIFICANT * error, RELEVANT_FORCE * balance.friction_size):
        return []
    roles = balance.estimator.equation.roles
    known = roles[OFFSET] is not None or roles[COULOMB_FORWARD] != roles[COULOMB_BACKWARD]
    remedy = "the constant load has changed" if known else "set offset = true to identify a constant load"
    return [f"Look here: a constant force of {mean:.2g} N is left: {remedy}."]


def friction_sentence(balance: Balance) -> str:
    """Where the measured friction leaves the model's line."""
    text = "Friction is the input force less mass times acceleration and offset, where the axis moves one way. "
    if balance.friction is None:
        return text + "The axis reverses too often here: too few samples to show it."
    left = balance.friction.left
    real = np.abs(left.mean) > np.maximum(SIGNIFICANT * left.error, RELEVANT_FORCE * balance.friction_size)
    if not np.any(real):
        return text + "It lies on the model's line."
    worst, slowest = int(np.argmax(real * np.abs(left.mean))), int(np.argmin(np.where(real, np.abs(left.x), np.inf)))
    places = " and ".join(
        _describe_deviation(left, k, balance.estimator.equation.motion) for k in dict.fromkeys((worst, slowest))
    )
    return text + f"Look here: the model's line is not the friction, which is {places}."


def _describe_deviation(left: Binned, k: int, own: Units) -> str:
    more = "more" if left.mean[k] * left.x[k] > 0 else "less"
    return f"{abs(left.mean[k]):.2g} {own.force} {more} at {left.x[k]:.2g} {own.speed}"


def correlation_sentence(balance: Balance) -> str:
    """Does the residual last longer than the filter makes it, and does it follow the input?"""
    found, dt = correlations(balance), balance.estimator.dt
    part = rms(balance.residual) / max(rms(balance.target), 1e-300)
    text = "The filter alone correlates neighbouring samples: the dashed line is what it makes of the encoder's error. "
    first = min(found.own.size - 1, round(FILTER_LAGS / (balance.estimator.cutoff * dt)))
    lasting = float(found.own[first:].mean())  # the mean: steps of a coarse encoder come back at an even speed
    size = f"a mean correlation of {lasting:.2g} from {first * dt:.2g} s to {(found.own.size - 1) * dt:.2g} s"
    if lasting > max(CORRELATED, SIGNIFICANT * found.own_error) and lasting * part > RELEVANT_PART:
        text += f"Look here: the residual keeps {size}: slow forces are not in the model. "
    else:
        text += f"Beyond it the residual forgets itself ({size}). "
    k = int(np.argmax(np.abs(found.cross)))
    peak, lag = abs(float(found.cross[k])), (k - found.cross.size // 2) * dt
    if peak <= SIGNIFICANT * found.cross_error or peak * part <= RELEVANT_PART:
        return text + f"It does not follow the input (correlation at most {peak:.2g})."
    order = f"{lag:.2g} s after" if lag > 0 else f"{-lag:.2g} s ahead of" if lag < 0 else "in step with"
    cause = "the input follows the residual, as under control" if lag < 0 else "the model misses a part of the dynamics"
    return text + f"Look here: it has a correlation of {peak:.2g} with the input, {order} it: {cause}."
