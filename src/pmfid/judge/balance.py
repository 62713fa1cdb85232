"""The force balance of a record at given parameters, and the means of what it leaves, over velocity and position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pmfid._stage import first_order
from pmfid.estimators.difference import rms
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import long_run_covariance
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    MASS,
    OFFSET,
    STIFFNESS,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
)
from pmfid.types import Floats

#: Encoder noise of the velocity, as a part of its standard deviation, that moves no sample to another bin to speak of.
QUIET_ENCODER = 0.003
#: Part of the filter's memory with one direction of motion, from which on friction is that of one velocity.
ONE_WAY = 0.95
MOST_BINS, FEWEST_BINS = 24, 6
FRICTION = (VISCOUS_FORWARD, VISCOUS_BACKWARD, COULOMB_FORWARD, COULOMB_BACKWARD)


@dataclass(frozen=True)
class Binned:
    """Means of a force over bins of equal numbers of samples: x, mean [N], its standard error, each (bins,)."""

    x: Floats
    mean: Floats
    error: Floats

    @property
    def _ends(self) -> tuple[int, int]:
        """The lowest and the highest mean, of those that are known well."""
        return int(np.argmin(self.mean + 2 * self.error)), int(np.argmax(self.mean - 2 * self.error))

    @property
    def change(self) -> float:
        """From the lowest to the highest mean [N]."""
        low, high = self._ends
        return abs(float(self.mean[high] - self.mean[low]))

    @property
    def score(self) -> float:
        """That change in its standard errors."""
        low, high = self._ends
        return self.change / max(float(np.hypot(self.error[low], self.error[high])), 1e-300)


@dataclass(frozen=True)
class Friction:
    """Filtered friction [N] over velocity [m/s], each (n,), and the means of what the model leaves of it."""

    velocity: Floats
    force: Floats
    left: Binned


@dataclass(frozen=True)
class Balance:
    """The record at theta, all filtered and (n,): time t [s], measured and simulated velocity [m/s], position [m],
    measured less simulated position, drift [m], not filtered; target [N] and regressors phi (n, p) of the force
    balance, and residual = target - phi theta [N]. estimator: `IV` on the same filters; theta: (p,)."""

    estimator: IV
    theta: Floats
    t: Floats
    measured: Floats
    simulated: Floats
    position: Floats
    drift: Floats
    target: Floats
    phi: Floats

    @cached_property
    def residual(self) -> Floats:
        return np.asarray(self.target - self.phi @ self.theta)

    @property
    def fit(self) -> float:
        """Fit of the simulated velocity, 100 (1 - |e| / |v - mean|) [%]."""
        spread = max(rms(self.measured - self.measured.mean()), 1e-300)
        return 100 * (1 - rms(self.measured - self.simulated) / spread)

    @cached_property
    def velocity(self) -> Floats:
        """To sort by: the simulated one where the measured one has encoder noise that the residual shares, and only
        there: under control it follows the residual."""
        return self.simulated if self.noisy and self.fit > 50.0 else self.measured

    @property
    def noisy(self) -> bool:
        """Would the encoder's error move samples to another bin?"""
        return self.encoder_noise > QUIET_ENCODER * float(np.std(self.measured))

    @property
    def encoder_noise(self) -> float:
        """Standard deviation of the filtered velocity [m/s] from white errors of the counts."""
        return self.estimator.encoder.resolution * float(np.linalg.norm(encoder_response(self)[0])) / math.sqrt(12)

    def part(self, *roles: int) -> Floats:
        """Force (n,) [N] of the parameters with these roles."""
        chosen = self._parameters(*roles)
        return np.asarray(self.phi[:, chosen] @ self.theta[chosen])

    def _parameters(self, *roles: int) -> list[int]:
        found = {self.estimator.equation.roles[role] for role in roles}
        return sorted(index for index in found if index is not None)

    @property
    def direction(self) -> Floats:
        """Filtered direction of the model, -1 to 1."""
        return np.asarray(self.phi[:, self._parameters(COULOMB_FORWARD, COULOMB_BACKWARD)].sum(axis=1))

    @property
    def friction_size(self) -> float:
        """Root mean square of the model's friction [N], at least a hundredth of the input force."""
        return max(rms(self.part(*FRICTION)), 0.01 * rms(self.target))

    def model_friction(self, velocity: Floats) -> Floats:
        """Friction [N] that the model has at a velocity (n,) [m/s]."""
        _, *friction = self.estimator.equation.role_values(self.theta)
        forward = friction[0] * velocity + friction[2]
        body = np.where(velocity > 0, forward, friction[1] * velocity - friction[3])
        sizes = dict(zip(self.estimator.names, self.theta, strict=False))
        shapes = [(sizes[str(term.name)], term.shape) for term in self.estimator.equation.shaped if term.shape]
        of_speed = sum(size * shape.at(np.abs(velocity)) for size, shape in shapes if shape.of_speed)
        return np.asarray(body + np.where(velocity > 0, 1.0, -1.0) * of_speed)

    def resistance(self, place: Floats, velocity: Floats) -> Floats:
        """Friction, load and forces along the travel [N] that the model has at places, counted from the first sample,
        and velocities, both (n,)."""
        values = self.estimator.equation.role_values(self.theta)
        total = self.model_friction(velocity) + values[OFFSET] + values[STIFFNESS] * place
        sizes = dict(zip(self.estimator.names, self.theta, strict=False))
        for term in self.estimator.equation.shaped:
            if term.shape is not None and not term.shape.of_speed:
                side = np.sign(velocity) if term.signal == "friction" else 1.0
                total = total + side * sizes[str(term.name)] * term.shape.at(place)
        return np.asarray(total)

    @cached_property
    def by_velocity(self) -> Binned:
        return average_in_bins(self.velocity, self.residual, self.lags)

    @cached_property
    def by_position(self) -> Binned:
        return average_in_bins(self.position, self.beside_velocity, self.lags)

    @cached_property
    def beside_velocity(self) -> Floats:
        """Residual less its mean at that velocity [N]: positions are not visited at all velocities alike."""
        return np.asarray(self.residual - np.interp(self.velocity, self.by_velocity.x, self.by_velocity.mean))

    @cached_property
    def friction(self) -> Friction | None:
        return one_way_friction(self)

    @property
    def lags(self) -> int:
        """Samples over which the filter correlates."""
        return min(self.estimator.settle_samples, self.t.size // 4)


def one_way_friction(balance: Balance) -> Friction | None:
    """Of the samples with one direction of motion; None where these are too few."""
    # the filtered velocity may still have the sign from before a reversal
    one_way = np.sign(balance.velocity) * balance.direction >= ONE_WAY
    if np.count_nonzero(one_way) < 2 * FEWEST_BINS:
        return None
    velocity = balance.velocity[one_way]
    force = (balance.target - balance.part(MASS, OFFSET, STIFFNESS))[one_way]
    return Friction(velocity, force, average_in_bins(velocity, balance.residual[one_way], balance.lags))


def low_pass(estimator: IV, signal: Floats) -> list[Floats]:
    """A signal (n,) after 1, 2, ... `order` stages of the Poisson chain, as the kernel has them for velocities."""
    slope, cutoff = 2 / estimator.dt, estimator.cutoff
    gain, pole = cutoff / (slope + cutoff), (slope - cutoff) / (slope + cutoff)
    nodes = [first_order(signal, pole, 2 * gain)[0]]
    for _ in range(estimator.order - 1):
        nodes.append(first_order(nodes[-1], pole, gain, gain)[0])
    return nodes


def encoder_response(balance: Balance) -> tuple[Floats, Floats]:
    """Answers to one wrong position of 1 m: filtered velocity [m/s] and residual [N], each (lags,)."""
    estimator = balance.estimator
    change = np.zeros(2 * estimator.settle_samples)
    change[:2] = 1 / estimator.dt, -1 / estimator.dt
    *_, before, velocity = low_pass(estimator, change)
    viscous = estimator.equation.role_values(balance.theta)[1]
    return velocity, balance.theta[estimator.equation.leading] * estimator.cutoff * (
        before - velocity
    ) + viscous * velocity


def average_in_bins(x: Floats, force: Floats, lags: int) -> Binned:
    """Means of a force (n,) over x (n,); standard errors for samples correlated over `lags` (Newey and West 1987)."""
    bins = int(np.clip(x.size // (2 * lags + 1), FEWEST_BINS, MOST_BINS))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))[1:-1]
    index, rows = np.searchsorted(edges, x, side="right"), []
    for k in np.unique(index):
        inside = index == k
        size, mean = int(np.count_nonzero(inside)), float(force[inside].mean())
        within = np.where(inside, force - mean, 0.0)[:, None]
        # steps of a coarse encoder cancel over long lags, and chance decides how well
        spread = max(long_run_covariance(within, window)[0, 0] for window in (lags, lags // 4))
        rows.append((float(x[inside].mean()), mean, float(np.sqrt(max(spread, 0.0))) / size))
    return Binned(*np.array(rows).T)
