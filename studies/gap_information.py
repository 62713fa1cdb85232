"""The information of a drive's record with missing samples: the Cramer-Rao bound for unknown inputs.

A Kalman filter whitens counts and sensitivities alike (Schweppe 1965).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.estimators.bridges import Body
from pmfid.estimators.iv import IV
from pmfid.types import Flags, Floats

#: Variance of a count [counts^2], and of an unknown start: position [counts^2] and velocity [counts^2/s^2].
COUNT, UNKNOWN = 1 / 12, (1e8, 1e12)
#: Step of the difference quotients, as a fraction of a parameter.
STEP = 1e-4


def sensitivities(method: IV, theta: Floats, u: Floats) -> Floats:
    """Return the change (p, n) of the position [counts] under u (n,) for a relative change of each parameter."""
    body, rows = _body(method, theta), []
    for i, value in enumerate(theta):
        step = STEP * value * np.eye(theta.size)[i]
        ends = [replace(body, theta=theta + side * step).speeds(u, 0.0)[0] for side in (1.0, -1.0)]
        rows.append(np.r_[0.0, np.cumsum(np.subtract(*ends)[:-1])] * method.dt / (2 * STEP))
    return np.array(rows)


def bound(method: IV, theta: Floats, effects: Floats, there: Flags, unknown: Floats) -> Floats:
    """Return the least relative standard deviations (p,).

    `effects` (p, n) are `sensitivities`. `there` (n,) marks the samples with a known count. `unknown` (n,) is the
    standard deviation of each input.
    """
    body, dt = _body(method, theta), method.dt
    push = method.equation.input_gain * dt / theta[method.equation.leading] / body.step
    kept = np.exp(-body.decay * dt)
    onward = np.array([[1.0, (1 - kept) / body.decay if body.decay > 0 else dt], [0.0, kept]])
    p, state, cov = theta.size, np.zeros((2, theta.size)), np.diag(UNKNOWN)
    information = np.zeros((p, p))
    for k, known in enumerate(there):
        if known:
            variance = cov[0, 0] + COUNT
            gain, new = cov[:, 0] / variance, effects[:, k] - state[0]
            information += np.outer(new, new) / variance
            state, cov = state + np.outer(gain, new), cov - np.outer(gain, cov[0])
        state, cov = onward @ state, onward @ cov @ onward.T
        if unknown[k]:
            blow = np.array([dt / 2, 1.0])
            cov += (push * unknown[k]) ** 2 * (np.outer(blow, blow) + np.diag([dt**2 / 12, 0.0]))
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(information))))


def _body(method: IV, theta: Floats) -> Body:
    return Body(method.equation, theta, method.dt, method.encoder.resolution, method.cutoff)
