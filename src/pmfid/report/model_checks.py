"""Does the model fit the record? Simulation from the input alone, and what the force balance leaves, in the report."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import lfilter

from pmfid.errors import PmfidError
from pmfid.estimators.auxiliary import role_values
from pmfid.estimators.base import like
from pmfid.estimators.batch import long_run_covariance
from pmfid.estimators.iv import IV
from pmfid.estimators.output_error import OE, held, rms
from pmfid.report.figures import COLOURS, GREY, MAGENTA, WIDTH, decimation, figure_style
from pmfid.report.html import Section, svg
from pmfid.session.pipeline import Result

Floats = NDArray[np.float64]

#: Standard deviations from which on a difference is taken for real: there are many bins and lags to choose from.
SIGNIFICANT = 4.5
#: A force that is real but a smaller part of the model's friction is not worth a warning.
RELEVANT_FORCE = 0.03
#: The same for a correlated part of the residual, as a part of the input force.
RELEVANT_PART = 0.005
#: Fit of the velocity [%] below which the model does not follow.
GOOD_FIT = 90.0
#: A velocity error so many times that of the encoder alone is the model's.
ABOVE_ENCODER = 3.0
#: Encoder noise of the velocity, as a part of its standard deviation, that moves no sample to another bin to speak of.
QUIET_ENCODER = 0.003
#: Correlation at lags that the filter no longer explains.
CORRELATED = 0.2
#: Filter time constants over which correlations are shown, and after which the filter alone leaves none.
SHOWN_LAGS, FILTER_LAGS = 10.0, 5.0
#: Part of the filter's memory with one direction of motion, from which on friction is that of one velocity.
ONE_WAY = 0.95
#: With a memory of so many times its length the estimate is of the last part of the record only.
MEMORIES = 3.0
MOST_BINS, FEWEST_BINS, MAX_DOTS = 24, 6, 1200


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

    def part(self, *names: str) -> Floats:
        """Force (n,) [N] of the parameters whose names start so."""
        chosen = [i for i, name in enumerate(self.estimator.names) if name.startswith(names)]
        return np.asarray(self.phi[:, chosen] @ self.theta[chosen])

    @property
    def direction(self) -> Floats:
        """Filtered direction of the model, -1 to 1."""
        chosen = [i for i, name in enumerate(self.estimator.names) if name.startswith("coulomb")]
        return np.asarray(self.phi[:, chosen].sum(axis=1))

    @property
    def friction_size(self) -> float:
        """Root mean square of the model's friction [N], at least a hundredth of the input force."""
        return max(rms(self.part("viscous", "coulomb")), 0.01 * rms(self.target))

    def model_friction(self, velocity: Floats) -> Floats:
        """Friction [N] that the model has at a velocity (n,) [m/s]."""
        _, *friction = role_values(self.estimator, list(self.theta))
        forward = friction[0] * velocity + friction[2]
        return np.where(velocity > 0, forward, friction[1] * velocity - friction[3])

    @cached_property
    def by_velocity(self) -> Binned:
        return binned(self.velocity, self.residual, self.lags)

    @cached_property
    def by_position(self) -> Binned:
        return binned(self.position, self.beside_velocity, self.lags)

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


def model_checks(result: Result) -> list[Section]:
    """Sections on the fit of the model at the result's theta; of a recursive method the last one.

    With a forgetting factor below 1 only the last three memories of the record are judged. Where the parameters are
    none of a drive (a mass that is not positive), or nothing can be simulated, one section says so.
    """
    try:
        balance = make_balance(result)
    except PmfidError as error:
        return [Section("Model checks", f"Not possible here: {error}.")]
    if balance is None:
        return [Section("Model checks", "Not possible here: no motion can be simulated with these parameters.")]
    checks: tuple[tuple[str, Callable[[Balance], str], Callable[[Balance], Figure]], ...] = (
        ("Simulated from the input alone", simulation_sentence, simulation_figure),
        ("Residual over velocity and position", residual_sentence, residual_figure),
        ("Friction over velocity", friction_sentence, friction_figure),
        ("Correlation of the residual", correlation_sentence, correlation_figure),
    )
    sections = [
        Section(f"Model check: {heading}", say(balance), svg=svg(draw(balance))) for heading, say, draw in checks
    ]
    remarks = (_window(result, balance), _feedback(result, balance), "", "")
    return [replace(part, text=part.text + remark) for part, remark in zip(sections, remarks, strict=True)]


def _feedback(result: Result, balance: Balance) -> str:
    if "feedback" not in result.status or not balance.noisy:
        return ""
    return (
        "\n\nThe input follows the residual in this record, and the encoder is coarse: then the encoder's own error "
        "differs with velocity and position, too. Look at a record in open loop before the model is changed."
    )


def _window(result: Result, balance: Balance) -> str:
    if getattr(result.estimator, "forgetting", 1.0) == 1.0:
        return ""
    start, end = balance.t[0], balance.t[-1]
    return (
        f"\n\nAll model checks are from {start:.4g} s to {end:.4g} s, {MEMORIES:g} memories of the estimate, with its "
        "last value."
    )


def make_balance(result: Result) -> Balance | None:
    """The record at the result's theta; None where it cannot be simulated. Raises PmfidError as `IV` does."""
    estimator, record = like(IV, result.estimator, prefilter_zeros=None, precision="float64"), result.record
    theta = np.asarray(result.theta[: len(estimator.names)], float)
    if not (np.all(np.isfinite(theta)) and theta[0] > 0):
        return None
    # a body pushed by its friction has no motion to compare with
    signed = np.array([name == "offset" for name in estimator.names])
    plausible = np.where(signed, theta, np.maximum(theta, 0.0))
    u = held(record.u)
    y = like(OE, estimator).position(record.counts)
    speed = simulated_velocity(estimator, plausible, u)
    columns = estimator.columns_at(plausible, u, record.counts)
    chosen = _recent(result, np.flatnonzero(columns.used))
    if not (np.all(np.isfinite(speed)) and chosen.size > 4 * FEWEST_BINS):
        return None
    measured, x = np.diff(y, append=y[-1]) / record.dt, np.r_[0.0, np.cumsum(speed[:-1])] * record.dt
    drift = (y - x)[chosen]
    rows = slice(columns.z.size - chosen.size, None)
    late = chosen - 2  # a sample ends the interval before it, and the columns of the kernel are one sample late
    slow, modelled, way = (low_pass(estimator, signal)[-1][late] for signal in (measured, speed, y - y[0]))
    t, target, phi = np.asarray(chosen * record.dt, float), columns.z[rows], columns.phi[rows]
    return Balance(estimator, theta, t, slow, modelled, y[0] + way, drift - drift[0], target, phi)


def _recent(result: Result, used: NDArray[np.int64]) -> NDArray[np.int64]:
    forgetting = getattr(result.estimator, "forgetting", 1.0)
    return used if forgetting == 1 else used[-max(round(MEMORIES / (1 - forgetting)), 1) :]


def simulated_velocity(estimator: IV, theta: Floats, u: Floats) -> Floats:
    """Mean velocity (n,) [m/s] of every interval, from rest, under the input u (n,) alone."""
    from pmfid import _kernel64

    roles = role_values(estimator, list(theta))
    return np.asarray(_kernel64.simulate(roles, estimator.model.input_gain, estimator.dt, u)[0])


def low_pass(estimator: IV, signal: Floats) -> list[Floats]:
    """A signal (n,) behind 1, 2, ... `order` stages of the Poisson chain, as the kernel has them for velocities."""
    slope, cutoff = 2 / estimator.dt, estimator.cutoff
    gain, pole = cutoff / (slope + cutoff), (slope - cutoff) / (slope + cutoff)
    nodes = [np.asarray(lfilter([2 * gain], [1, -pole], signal))]
    for _ in range(estimator.order - 1):
        nodes.append(np.asarray(lfilter([gain, gain], [1, -pole], nodes[-1])))
    return nodes


def encoder_response(balance: Balance) -> tuple[Floats, Floats]:
    """Answers to one wrong position of 1 m: filtered velocity [m/s] and residual [N], each (lags,)."""
    estimator = balance.estimator
    change = np.zeros(2 * estimator.settle_samples)
    change[:2] = 1 / estimator.dt, -1 / estimator.dt
    *_, before, velocity = low_pass(estimator, change)
    viscous = role_values(estimator, list(balance.theta))[1]
    return velocity, balance.theta[0] * estimator.cutoff * (before - velocity) + viscous * velocity


def binned(x: Floats, force: Floats, lags: int) -> Binned:
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
        return f"No dependence on {name} can be told from chance (the means differ by {size})."
    if found.change < RELEVANT_FORCE * balance.friction_size:
        return f"The residual hardly changes with {name} (by {size})."
    return f"Look here: the residual changes with {name} by {size}: {cause}."


def _constant(balance: Balance) -> list[str]:
    mean = float(balance.residual.mean())
    error = np.sqrt(long_run_covariance(balance.residual[:, None] - mean, balance.lags)[0, 0]) / balance.t.size
    if abs(mean) < max(SIGNIFICANT * error, RELEVANT_FORCE * balance.friction_size):
        return []
    known = "offset" in balance.estimator.names or balance.estimator.model.friction == "directional"
    remedy = "the constant load has changed" if known else "set offset = true to identify a constant load"
    return [f"Look here: a constant force of {mean:.2g} N is left: {remedy}."]


def one_way_friction(balance: Balance) -> Friction | None:
    """Of the samples with one direction of motion; None where these are too few."""
    # the filtered velocity may still have the sign from before a reversal
    one_way = np.sign(balance.velocity) * balance.direction >= ONE_WAY
    if np.count_nonzero(one_way) < 2 * FEWEST_BINS:
        return None
    velocity = balance.velocity[one_way]
    force = (balance.target - balance.part("mass", "offset"))[one_way]
    return Friction(velocity, force, binned(velocity, balance.residual[one_way], balance.lags))


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
    places = " and ".join(_off_the_line(left, k) for k in dict.fromkeys((worst, slowest)))
    return text + f"Look here: the model's line is not the friction, which is {places}."


def _off_the_line(left: Binned, k: int) -> str:
    more = "more" if left.mean[k] * left.x[k] > 0 else "less"
    return f"{abs(left.mean[k]):.2g} N {more} at {left.x[k]:.2g} m/s"


def _correlation(a: Floats, b: Floats, lags: int) -> Floats:
    """Correlation (2 lags + 1,) of a(k) with b(k + lag), lag = -lags ... lags; a, b: (n,)."""
    a, b = a - a.mean(), b - b.mean()
    size = 2 ** int(np.ceil(np.log2(a.size + lags + 1)))
    cross = np.fft.irfft(np.fft.rfft(a, size).conj() * np.fft.rfft(b, size), size)
    power = max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    return np.asarray(np.r_[cross[-lags:], cross[: lags + 1]] / power)


@dataclass(frozen=True)
class Correlations:
    """Of the residual with itself, own (lags + 1,), and of the input force with the residual `lag` samples later,
    cross (2 lags + 1,); encoder (lags + 1,): of the residual if only the encoder's error were in it; own_error,
    cross_error: standard deviations of either for nothing but the encoder's error (Bartlett 1935)."""

    own: Floats
    cross: Floats
    encoder: Floats
    own_error: float
    cross_error: float


def correlations(balance: Balance) -> Correlations:
    """Over 10 filter time constants, or a quarter of a short record."""
    n = balance.t.size
    lags = max(2, min(round(SHOWN_LAGS / (balance.estimator.cutoff * balance.estimator.dt)), n // 4))
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
    order = f"{lag:.2g} s behind" if lag > 0 else f"{-lag:.2g} s ahead of" if lag < 0 else "in step with"
    cause = "the input follows the residual, as under control" if lag < 0 else "the model misses a part of the dynamics"
    return text + f"Look here: it has a correlation of {peak:.2g} with the input, {order} it: {cause}."


def simulation_figure(balance: Balance) -> Figure:
    """Filtered velocity measured and simulated, and the position measured less simulated, over time."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        for signal, label, style in ((balance.measured, "measured", "-"), (balance.simulated, "simulated", "--")):
            i = decimation(signal)
            upper.plot(balance.t[i], signal[i], style, lw=0.9, label=label)
        upper.set_ylabel("filtered velocity [m/s]")
        upper.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
        i = decimation(balance.drift)
        lower.plot(balance.t[i], balance.drift[i], color=COLOURS[2])
        lower.set_ylabel("position, measured\nless simulated [m]")
        lower.set_xlabel("time [s]")
        lower.margins(x=0)
    return figure


def residual_figure(balance: Balance) -> Figure:
    """The residual over velocity and position: samples, and means with two standard errors."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        views = (
            (balance.velocity, balance.residual, balance.by_velocity, "filtered velocity [m/s]"),
            (balance.position, balance.beside_velocity, balance.by_position, "filtered position [m]"),
        )
        for axes, (x, force, found, label) in zip(panels, views, strict=True):
            _dots(axes, x, force)
            _means(axes, found, found.mean)
            axes.set_xlabel(label)
        panels[0].set_ylabel("residual [N]")
        panels[1].set_ylabel("less its mean at the velocity [N]")
        _limits(panels[0], balance.residual)
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
    return figure


def friction_figure(balance: Balance) -> Figure:
    """Friction force over velocity, measured, with the model's line."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.8), layout="constrained")
        axes = figure.subplots()
        if balance.friction is not None:
            left = balance.friction.left
            _dots(axes, balance.friction.velocity, balance.friction.force)
            _means(axes, left, left.mean + balance.model_friction(left.x))
            _limits(axes, balance.friction.force)
        end = np.max(np.abs(balance.velocity)) * 1.02
        line = np.array([-end, -1e-9 * end, 1e-9 * end, end])
        axes.plot(line, balance.model_friction(line), color=MAGENTA, ls="--", label="model")
        axes.set_xlabel("filtered velocity [m/s]")
        axes.set_ylabel("filtered friction [N]")
        axes.legend(loc="upper left")
    return figure


def correlation_figure(balance: Balance) -> Figure:
    """Correlation of the residual with itself and with the input force, with bounds of three standard deviations."""
    found, dt = correlations(balance), balance.estimator.dt
    lags = np.arange(found.own.size) * dt
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        own, cross = figure.subplots(1, 2)
        own.plot(lags, found.own, label="residual")
        own.plot(lags, found.encoder, "--", color=GREY, label="encoder's error alone, filtered")
        own.set_ylabel("autocorrelation [-]")
        own.legend(loc="upper right")
        cross.plot(np.r_[-lags[:0:-1], lags], found.cross)
        cross.set_ylabel("correlation with the input [-]")
        cross.set_ylim(*(np.array([-1.15, 1.15]) * max(np.max(np.abs(found.cross)), 3 * found.cross_error)))
        for axes, error in ((own, found.own_error), (cross, found.cross_error)):
            axes.axhspan(-3 * error, 3 * error, color=COLOURS[3], alpha=0.25, lw=0)
            axes.margins(x=0)
            axes.locator_params(axis="x", nbins=6)
        own.set_xlabel("lag [s]")
        cross.set_xlabel("lag behind the input [s]")
    return figure


def _dots(axes: Axes, x: Floats, y: Floats) -> None:
    every = -(-x.size // MAX_DOTS)
    axes.plot(x[::every], y[::every], ".", color=COLOURS[4], alpha=0.7, ms=3.5, mew=0, label="samples")


def _means(axes: Axes, found: Binned, mean: Floats) -> None:
    label = "means ±2 standard errors"
    axes.errorbar(found.x, mean, 2 * found.error, fmt="o", color=COLOURS[1], ms=4, capsize=2, label=label)


def _limits(axes: Axes, y: Floats) -> None:
    """So that a few wild samples do not flatten the rest."""
    low, high = (float(limit) for limit in np.quantile(y, (0.002, 0.998)))
    margin = 0.1 * (high - low) or 1e-6
    axes.set_ylim(low - margin, high + margin)
