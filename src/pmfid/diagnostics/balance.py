"""The force balance along the motion, and the correlations of the residual force."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pmfid._stage import first_order
from pmfid.diagnostics.drives import recent
from pmfid.diagnostics.free_run import rms
from pmfid.diagnostics.tuning import TUNING
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import hold_last_input, like
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import long_run_covariance
from pmfid.estimators.motion_fit import MotionFit
from pmfid.fit.free_motion import simulate_from_rest
from pmfid.models.axes import Units
from pmfid.models.drive import EquationModel
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

FRICTION = (VISCOUS_FORWARD, VISCOUS_BACKWARD, COULOMB_FORWARD, COULOMB_BACKWARD)


@dataclass(frozen=True)
class Binned:
    """Means of a force over bins with equal numbers of samples.

    The bin centres x, the means [N] and their standard errors [N] have shape (bins,).
    """

    x: Floats
    mean: Floats
    error: Floats

    @property
    def _ends(self) -> tuple[int, int]:
        """The bins with the lowest and the highest mean. The choice disfavours means with large errors."""
        return int(np.argmin(self.mean + 2 * self.error)), int(np.argmax(self.mean - 2 * self.error))

    @property
    def change(self) -> float:
        """The difference between the highest and the lowest mean [N]."""
        low, high = self._ends
        return abs(float(self.mean[high] - self.mean[low]))

    @property
    def score(self) -> float:
        """The difference between the highest and the lowest mean in standard errors."""
        low, high = self._ends
        return self.change / max(float(np.hypot(self.error[low], self.error[high])), 1e-300)


@dataclass(frozen=True)
class Friction:
    """The filtered friction [N] over the velocity [m/s], each (n,), and the means of the friction that the model
    leaves.
    """

    velocity: Floats
    force: Floats
    left: Binned


@dataclass(frozen=True)
class Balance:
    """The filtered signals of a record at theta (p,), each (n,).

    The signals are time t [s], measured and simulated velocity [m/s], position [m] and measured minus simulated
    position [m]. The drift [m] is not filtered. The force balance has a target [N] and regressors phi (n, p), with
    residual = target - phi theta [N]. `estimator` is an `IV` with the same filters.
    """

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
        """The fit of the simulated velocity, 100 (1 - |e| / |v - mean|) [%]."""
        spread = max(rms(self.measured - self.measured.mean()), 1e-300)
        return 100 * (1 - rms(self.measured - self.simulated) / spread)

    @cached_property
    def velocity(self) -> Floats:
        """The velocity that sorts the samples into bins.

        The measured velocity is the usual choice, because under control the simulated velocity follows the residual.
        The simulated velocity is used only if the encoder noise in the measured velocity also appears in the residual.
        """
        return self.simulated if self.noisy and self.fit > 50.0 else self.measured

    @property
    def noisy(self) -> bool:
        """Whether the encoder's error moves samples to another bin."""
        return self.encoder_noise > TUNING.quiet_encoder * float(np.std(self.measured))

    @property
    def encoder_noise(self) -> float:
        """The standard deviation of the filtered velocity [m/s] for white errors of the counts."""
        return self.estimator.encoder.resolution * float(np.linalg.norm(encoder_response(self)[0])) / math.sqrt(12)

    def part(self, *roles: int) -> Floats:
        """Return the force (n,) [N] of the parameters with the given roles."""
        chosen = self._parameters(*roles)
        return np.asarray(self.phi[:, chosen] @ self.theta[chosen])

    def _parameters(self, *roles: int) -> list[int]:
        found = {self.estimator.equation.roles[role] for role in roles}
        return sorted(index for index in found if index is not None)

    @property
    def direction(self) -> Floats:
        """The filtered direction of motion in the model, from -1 to 1."""
        return np.asarray(self.phi[:, self._parameters(COULOMB_FORWARD, COULOMB_BACKWARD)].sum(axis=1))

    @property
    def friction_size(self) -> float:
        """The root mean square of the model's friction [N], at least a hundredth of the input force."""
        return max(rms(self.part(*FRICTION)), 0.01 * rms(self.target))

    def model_friction(self, velocity: Floats) -> Floats:
        """Return the friction [N] of the model at a velocity (n,) [m/s]."""
        _, *friction = self.estimator.equation.role_values(self.theta)
        forward = friction[0] * velocity + friction[2]
        body = np.where(velocity > 0, forward, friction[1] * velocity - friction[3])
        sizes = dict(zip(self.estimator.names, self.theta, strict=False))
        shapes = [(sizes[str(term.name)], term.shape) for term in self.estimator.equation.shaped if term.shape]
        of_speed = sum(size * shape.evaluate(np.abs(velocity)) for size, shape in shapes if shape.of_speed)
        return np.asarray(body + np.where(velocity > 0, 1.0, -1.0) * of_speed)

    @cached_property
    def by_velocity(self) -> Binned:
        return average_in_bins(self.velocity, self.residual, self.lags)

    @cached_property
    def by_position(self) -> Binned:
        return average_in_bins(self.position, self.beside_velocity, self.lags)

    @cached_property
    def beside_velocity(self) -> Floats:
        """The residual minus its mean at the same velocity [N]. Without the mean, places that the axis visits at
        different velocities are comparable.
        """
        return np.asarray(self.residual - np.interp(self.velocity, self.by_velocity.x, self.by_velocity.mean))

    @cached_property
    def friction(self) -> Friction | None:
        return one_way_friction(self)

    @property
    def lags(self) -> int:
        """The number of samples over which the filter causes correlation."""
        return min(self.estimator.settle_samples, self.t.size // 4)


def one_way_friction(balance: Balance) -> Friction | None:
    """Return the friction of the samples with a single direction of motion, or None if too few such samples exist."""
    # After a reversal, the filtered velocity may still have the old sign.
    one_way = np.sign(balance.velocity) * balance.direction >= TUNING.one_way
    if np.count_nonzero(one_way) < 2 * TUNING.fewest_bins:
        return None
    velocity = balance.velocity[one_way]
    force = (balance.target - balance.part(MASS, OFFSET, STIFFNESS))[one_way]
    return Friction(velocity, force, average_in_bins(velocity, balance.residual[one_way], balance.lags))


def low_pass(estimator: IV, signal: Floats) -> list[Floats]:
    """Return a signal (n,) after each of the `order` stages of the Poisson chain, in the kernel's arithmetic for
    velocities.
    """
    slope, cutoff = 2 / estimator.dt, estimator.cutoff
    gain, pole = cutoff / (slope + cutoff), (slope - cutoff) / (slope + cutoff)
    nodes = [first_order(signal, pole, 2 * gain)[0]]
    for _ in range(estimator.order - 1):
        nodes.append(first_order(nodes[-1], pole, gain, gain)[0])
    return nodes


def encoder_response(balance: Balance) -> tuple[Floats, Floats]:
    """Return the filtered velocity [m/s] and the residual [N], each (lags,), after a single wrong position of 1 m."""
    estimator = balance.estimator
    change = np.zeros(2 * estimator.settle_samples)
    change[:2] = 1 / estimator.dt, -1 / estimator.dt
    *_, before, velocity = low_pass(estimator, change)
    viscous = estimator.equation.role_values(balance.theta)[1]
    return velocity, balance.theta[estimator.equation.leading] * estimator.cutoff * (
        before - velocity
    ) + viscous * velocity


def average_in_bins(x: Floats, force: Floats, lags: int) -> Binned:
    """Return the means of a force (n,) over x (n,), with standard errors for correlated samples (Newey and West 1987).

    The samples are correlated over `lags` samples.
    """
    bins = int(np.clip(x.size // (2 * lags + 1), TUNING.fewest_bins, TUNING.most_bins))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))[1:-1]
    index, rows = np.searchsorted(edges, x, side="right"), []
    for k in np.unique(index):
        inside = index == k
        size, mean = int(np.count_nonzero(inside)), float(force[inside].mean())
        within = np.where(inside, force - mean, 0.0)[:, None]
        # The steps of a coarse encoder cancel over long lags, and chance decides how well they cancel.
        spread = max(long_run_covariance(within, window)[0, 0] for window in (lags, lags // 4))
        rows.append((float(x[inside].mean()), mean, float(np.sqrt(max(spread, 0.0))) / size))
    return Binned(*np.array(rows).T)


def make_balance(
    estimator: Estimator, u: ArrayLike, counts: ArrayLike, theta: ArrayLike, inputs: ArrayLike | None = None
) -> Balance | None:
    """Return the force balance of the record u (n,), counts (n,) at theta (p,).

    Samples without u are left out. `inputs` (n,) are inputs that are known there nevertheless, or NaN, and move the
    simulated axis. With forgetting, the balance covers the last three memories. The result is None if the
    model cannot be simulated.

    Raises PmfidError as `IV` does.
    """
    if estimator.equation.without_simulation:
        return None
    equation, p = estimator.equation, len(estimator.equation.names)
    known = {"model": EquationModel(equation.known_at(np.asarray(theta, float)[p:]))} if equation.further else {}
    twin = like(IV, estimator, prefilter_zeros=None, precision="float64", **known)
    at = np.asarray(theta, float)[: len(twin.names)]
    if not (np.all(np.isfinite(at)) and at[twin.equation.leading] > 0):
        return None
    # A plant that is pushed by its friction has no motion for a comparison.
    plausible = np.where(twin.equation.positive, np.maximum(at, 0.0), at)
    u, counts, dt = np.asarray(u, float), np.asarray(counts), twin.intervals
    acting = hold_last_input(u if inputs is None else np.where(np.isfinite(u), u, np.asarray(inputs, float)))
    y, x = like(MotionFit, twin).position(counts), simulate_from_rest(twin.equation, plausible, acting, dt)
    speed = np.diff(x) / dt
    columns = twin.columns_at(plausible, u, counts)
    used = np.flatnonzero(columns.used)
    chosen = used[recent(estimator, used.size)]
    if not (np.all(np.isfinite(speed)) and chosen.size > 4 * TUNING.fewest_bins):
        return None
    measured, time = np.diff(y, append=y[-1]) / dt, np.cumsum(np.broadcast_to(dt, y.shape)) - dt
    drift = (y - x[:-1])[chosen]
    rows = slice(columns.z.size - chosen.size, None)
    late = chosen - 2  # A sample ends the preceding interval, and the columns of the kernel are one sample late.
    slow, modelled, way = (low_pass(twin, signal)[-1][late] for signal in (measured, speed, y - y[0]))
    t, target, phi = time[chosen], columns.z[rows], columns.phi[rows]
    return Balance(twin, at, t, slow, modelled, y[0] + way, drift - drift[0], target, phi)


@dataclass(frozen=True)
class Correlations:
    """Correlations of the residual, and their values for the encoder's error alone.

    `own` (lags + 1,) correlates the residual with itself. `cross` (2 lags + 1,) correlates the input force with the
    residual `lag` samples later. `encoder` (lags + 1,) is the autocorrelation of a residual that contains only the
    encoder's error. `own_error` and `cross_error` are standard deviations of the correlations for the encoder's error
    alone (Bartlett 1935).
    """

    own: Floats
    cross: Floats
    encoder: Floats
    own_error: float
    cross_error: float


def correlations(balance: Balance) -> Correlations:
    """Return the correlations of the residual over 10 filter time constants, or over a quarter of a short record."""
    n = balance.t.size
    lags = max(2, min(round(TUNING.shown_lags / (balance.estimator.cutoff * balance.estimator.dt)), n // 4))
    response = encoder_response(balance)[1]
    reach = response.size - 1
    power = np.correlate(response, response, "full")[reach:] / float(response @ response)
    encoder = np.r_[power, np.zeros(lags)][: lags + 1]
    memory = min(n // 4, 10 * lags)
    own, force = (_correlation(s, s, memory)[memory:] for s in (balance.residual, balance.target))
    cross_variance = (1 + 2 * float(np.sum(own[1:] * force[1:]))) / n
    own_variance = (1 + 2 * float(np.sum(power[1:] ** 2))) / n
    cross = _correlation(balance.target, balance.residual, lags)
    return Correlations(
        own[: lags + 1], cross, encoder, float(np.sqrt(own_variance)), float(np.sqrt(max(cross_variance, 0.2 / n)))
    )


def _correlation(a: Floats, b: Floats, lags: int) -> Floats:
    """Return the correlation (2 lags + 1,) of a(k) with b(k + lag) for lag = -lags ... lags, with a, b (n,)."""
    a, b = a - a.mean(), b - b.mean()
    size = 2 ** int(np.ceil(np.log2(a.size + lags + 1)))
    cross = np.fft.irfft(np.fft.rfft(a, size).conj() * np.fft.rfft(b, size), size)
    power = max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    return np.asarray(np.r_[cross[-lags:], cross[: lags + 1]] / power)


def simulation_sentence(balance: Balance) -> str:
    """Describe how well the simulated velocity follows the motion, and how far the position drifts."""
    error = rms(balance.measured - balance.simulated)
    text = f"Fit of the simulated velocity: {balance.fit:.1f} %. "
    if balance.fit < TUNING.good_fit and error > TUNING.above_encoder * balance.encoder_noise:
        text += "Warning: the model does not follow the measured motion, and the encoder does not explain this. "
    elif balance.fit < TUNING.good_fit:
        text += "The encoder's own error explains the rest. "
    else:
        text += "The model follows the measured motion. "
    far, travel = float(np.max(np.abs(balance.drift))), float(np.ptp(balance.position))
    unit, part = balance.estimator.equation.motion.travel, far / max(travel, 1e-300)
    return text + (
        f"The simulated position departs by up to {far:.2g} {unit}, {100 * part:.3g} % of the travel, because every "
        "error of the velocity adds up."
    )


def residual_sentence(balance: Balance) -> str:
    """Describe whether the residual depends on velocity or position, and whether it contains a constant force."""
    causes = {
        "velocity": "friction is not Coulomb plus viscous, or the friction parameters are wrong",
        "position": "a cogging force, a spring, a slope or friction that varies along the travel is not in the model",
    }
    sentences = [
        _dependence(balance, found, name, causes[name])
        for name, found in (("velocity", balance.by_velocity), ("position", balance.by_position))
    ]
    return " ".join([*sentences, *_constant(balance)])


def _dependence(balance: Balance, found: Binned, name: str, cause: str) -> str:
    force = balance.estimator.equation.motion.force
    size = f"{found.change:.2g} {force}, {100 * found.change / balance.friction_size:.2g} % of the model's friction"
    if found.score <= TUNING.significant:
        return f"The residual depends on {name} no more than by chance (the means differ by {size})."
    if found.change < TUNING.relevant_force * balance.friction_size:
        return f"The residual hardly changes with {name} (by {size})."
    return f"Warning: the residual changes with {name} by {size}. Possible cause: {cause}."


def _constant(balance: Balance) -> list[str]:
    mean = float(balance.residual.mean())
    error = np.sqrt(long_run_covariance(balance.residual[:, None] - mean, balance.lags)[0, 0]) / balance.t.size
    if abs(mean) < max(TUNING.significant * error, TUNING.relevant_force * balance.friction_size):
        return []
    roles = balance.estimator.equation.roles
    known = roles[OFFSET] is not None or roles[COULOMB_FORWARD] != roles[COULOMB_BACKWARD]
    remedy = "The constant load has changed" if known else "Set offset = true in [model] to identify this load"
    force = balance.estimator.equation.motion.force
    return [f"Warning: the residual contains a constant load of {mean:.2g} {force}. {remedy}."]


def friction_sentence(balance: Balance) -> str:
    """Describe where the measured friction deviates from the model's line."""
    inertia = balance.estimator.equation.motion.inertia
    text = f"Friction is the input minus {inertia} times acceleration, minus the offset, while the axis moves one way. "
    if balance.friction is None:
        return text + "The axis reverses too often on this record to show the friction."
    left = balance.friction.left
    real = np.abs(left.mean) > np.maximum(
        TUNING.significant * left.error, TUNING.relevant_force * balance.friction_size
    )
    if not np.any(real):
        return text + "The friction lies on the model's line."
    worst, slowest = int(np.argmax(real * np.abs(left.mean))), int(np.argmin(np.where(real, np.abs(left.x), np.inf)))
    places = " and ".join(
        _describe_deviation(left, k, balance.estimator.equation.motion) for k in dict.fromkeys((worst, slowest))
    )
    return text + f"Warning: compared with the model's line, the friction is {places}."


def _describe_deviation(left: Binned, k: int, own: Units) -> str:
    more = "more" if left.mean[k] * left.x[k] > 0 else "less"
    return f"{abs(left.mean[k]):.2g} {own.force} {more} at {left.x[k]:.2g} {own.speed}"


def correlation_sentence(balance: Balance) -> str:
    """Describe whether the residual correlates longer than the filter explains, and whether it follows the input."""
    found, dt = correlations(balance), balance.estimator.dt
    part = rms(balance.residual) / max(rms(balance.target), 1e-300)
    text = (
        "The filter alone correlates neighbouring samples; the dashed line shows the encoder's error after the filter. "
    )
    first = min(found.own.size - 1, round(TUNING.filter_lags / (balance.estimator.cutoff * dt)))
    # The mean is robust, because at an even speed the steps of a coarse encoder are periodic.
    lasting = float(found.own[first:].mean())
    size = f"a mean correlation of {lasting:.2g} from {first * dt:.2g} s to {(found.own.size - 1) * dt:.2g} s"
    if (
        lasting > max(TUNING.balance_correlated, TUNING.significant * found.own_error)
        and lasting * part > TUNING.relevant_part
    ):
        text += f"Warning: the residual keeps {size}, so the model leaves out slow forces. "
    else:
        text += f"At longer delays the residual is uncorrelated ({size}). "
    k = int(np.argmax(np.abs(found.cross)))
    peak, lag = abs(float(found.cross[k])), (k - found.cross.size // 2) * dt
    if peak <= TUNING.significant * found.cross_error or peak * part <= TUNING.relevant_part:
        return text + f"The residual does not follow the input (correlation at most {peak:.2g})."
    order = f"{lag:.2g} s later" if lag > 0 else f"{-lag:.2g} s earlier" if lag < 0 else "at the same time"
    cause = "the input follows the residual, as under control" if lag < 0 else "the model misses a part of the dynamics"
    text += f"Warning: the residual correlates with the input ({peak:.2g}), and comes {order}. "
    return text + f"Possible cause: {cause}."
