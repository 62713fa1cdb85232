"""Coloured residuals: their model, their tests, and the covariance of an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.linear.experiment import Grid, RecordStretch
from pmfid.linear.solve import ProcessPoint, ProcessProblem
from pmfid.linear.tuning import TUNING
from pmfid.types import Flags, Floats, Places

#: The rows of a residual, and orthonormal columns (r, q) that a fit removed from them.
Removed = Sequence[tuple[slice, Floats]]


@dataclass(frozen=True, eq=False)
class Noise:
    """An autoregressive noise v[t] = sum_j coefficients[j-1] v[t-j] + w[t] with white w.

    The model has coefficients (k,), the variance of w and the power of v.
    """

    coefficients: Floats
    variance: float
    power: float

    @property
    def whitener(self) -> Floats:
        """The weights (k + 1,) of v[t], v[t-1], ... that give w[t]."""
        return np.asarray(np.r_[1.0, -self.coefficients])

    def effective(self, samples: int) -> float:
        """Return the number of white noise samples whose correlations have the same uncertainty (Bartlett 1935)."""
        spectrum = self._spectrum(TUNING.residuals_effective)
        return samples * float(np.mean(spectrum) ** 2 / np.mean(spectrum**2))

    def covariance(self, weights: Floats, place: Places) -> Floats:
        """Return the covariance (p, p) of sum_t weights[t] v[place[t]] for weights (N, p) at rising places (N,)."""
        laid = np.fft.rfft(_place_on_line(weights, place, size := _size(place)), axis=0)
        twice = np.full(laid.shape[0], 2.0)
        twice[0] = twice[-1] = 1.0
        weighted = laid * (twice * self._spectrum(size))[:, None]
        return np.asarray((laid.conj().T @ weighted).real / size)

    def times(self, weights: Floats, place: Places) -> Floats:
        """Return the product (N, p) of the noise's covariance matrix and weights (N, p)."""
        size = _size(place)
        laid = np.fft.rfft(_place_on_line(weights, place, size), axis=0)
        response = np.fft.irfft(laid * self._spectrum(size)[:, None], size, axis=0)
        return np.asarray(response[place - place[0]])

    def _spectrum(self, size: int) -> Floats:
        return np.asarray(self.variance / np.abs(np.fft.rfft(self.whitener, size)) ** 2)


def fit_noise(error: Floats, place: Places, taken: Removed = ()) -> Noise:
    """Return the noise model of a residual (N,) at rising places (N,).

    Akaike's criterion with the correction of Hurvich and Tsai (1989) selects the order. `taken` holds
    orthonormal columns (r, q) that a fit removed from r rows of the noise. The function restores the expected part of
    the removed columns in each autocovariance.
    """
    most = min(TUNING.residuals_most, max(1, error.size // TUNING.residuals_part))
    laid, there = _place_on_line(error, place, _size(place)), _place_on_line(np.ones(error.size), place, _size(place))
    pairs = np.maximum(_autocovariance(there, most), 1e-9)
    # The sums are divided by one number and not by the count of pairs. With the count of pairs, the result may be no
    # valid covariance, and spectral lines appear.
    raw = _autocovariance(laid, most) / pairs[0]
    if pairs[0] - pairs[1] > TUNING.residuals_gaps * error.size and np.any(
        np.abs(raw[1 : TUNING.residuals_soon]) > 4 * raw[0] / np.sqrt(error.size)
    ):
        raw = _correlate_over_gaps(error, place, most)
    noise = _from_autocovariance(raw, error.size)
    for _ in range(TUNING.residuals_passes if taken else 0):
        effects = [_compute_fit_effect(noise, columns, place[rows], most) for rows, columns in taken]
        put_back = raw + np.sum(effects, axis=0) / pairs[0]
        if not put_back[0] < TUNING.residuals_largest * raw[0]:
            break
        noise = _from_autocovariance(put_back, error.size)
    return noise


def whiten_columns(noise: Noise, columns: Floats, place: Places) -> Floats:
    """Return columns (N, c) after the whitening filter (N, c), with zeros for missing samples."""
    laid = _place_on_line(columns, place, int(place[-1] - place[0]) + 1)
    result = laid.copy()
    for lag, value in enumerate(noise.coefficients, start=1):
        result[lag:] -= value * laid[:-lag]
    return np.asarray(result[place - place[0]])


def _compute_fit_effect(noise: Noise, taken: Floats, place: Places, most: int) -> Floats:
    """Return by how much (most + 1,) a fit is expected to decrease the sums e[t] e[t+k] of the noise.

    With the projection 1 - Q Q^T and the shift S, the decrease is the trace of 2 Q^T S R Q - Q^T S Q Q^T R Q.
    """
    coloured = noise.times(taken, place)
    inside = taken.T @ coloured
    size = int(place[-1] - place[0]) + 1
    Q, RQ = _place_on_line(taken, place, size), _place_on_line(coloured, place, size)
    found = np.zeros(most + 1)
    for k in range(min(most + 1, size)):
        early, late = Q[: size - k], Q[k:]
        crossed = np.sum(early * RQ[k:]) + np.sum(late * RQ[: size - k])
        found[k] = crossed - np.sum((early.T @ late) * inside)
    return found


def _correlate_over_gaps(error: Floats, place: Places, most: int) -> Floats:
    """Return the autocovariance (most + 1,) with straight lines over short gaps.

    With gaps, the sums for different lags have different pairs of samples. For slow noise, the sums differ by more than
    the variance of a prediction, so that no valid model follows.
    """
    line = np.arange(int(place[-1] - place[0]) + 1) + place[0]
    nearest = np.searchsorted(place, line)
    long = place[nearest] - np.r_[place[0], place][nearest] > most
    filled = np.where(long & ~np.isin(line, place), 0.0, np.interp(line, place, error))
    found = _autocovariance(filled, most)
    return np.asarray(found / found[0] * float(error @ error) / error.size)


def _from_autocovariance(r: Floats, samples: int) -> Noise:
    """Return the noise model from an autocovariance by Levinson's recursion.

    A reflection coefficient of 1 or more ends the recursion, because such an order is invalid.
    """
    a, variance = np.zeros(0), max(float(r[0]), 1e-300)
    best, least = Noise(a, variance, variance), samples * np.log(variance)
    for order in range(1, r.size):
        reflection = (r[order] - a @ r[order - 1 : 0 : -1]) / variance
        if not abs(reflection) < 1 or samples - order - 2 <= 0:
            break
        a = np.r_[a - reflection * a[::-1], reflection]
        variance *= 1 - reflection**2
        criterion = samples * np.log(max(variance, 1e-300)) + 2 * (order + 1) * samples / (samples - order - 2)
        if criterion < least:
            best, least = Noise(a, variance, float(r[0])), criterion
    return best


def _autocovariance(laid: Floats, most: int) -> Floats:
    return np.array([float(laid[: laid.size - k] @ laid[k:]) if k < laid.size else 0.0 for k in range(most + 1)])


def _place_on_line(columns: Floats, place: Places, size: int) -> Floats:
    """Return columns (N, ...) on the line, with zeros at places without a sample."""
    line = np.zeros((size, *columns.shape[1:]))
    line[place - place[0]] = columns
    return line


def _size(place: Places) -> int:
    """Return a size for a transform in which the end of the line does not reach its beginning."""
    return 1 << int(2 * (place[-1] - place[0]) + TUNING.residuals_round).bit_length()


def is_white(error: Floats) -> bool:
    """Return whether a residual (n,) is white, up to a few autocorrelations that exceed their bounds by chance."""
    power = max(float(error @ error), 1e-300)
    auto = np.array([correlate_at_lag(error, error, lag) for lag in range(1, TUNING.residuals_lags + 1)]) / power
    return few_beyond(auto, TUNING.residuals_deviate / float(np.sqrt(max(error.size, 1))))


def few_beyond(correlations: Floats, bound: float) -> bool:
    """Return whether chance explains the number of correlations (k,) beyond a bound of 99 %."""
    return int(np.sum(np.abs(correlations) > bound)) <= 3


def correlate_at_lag(early: Floats, late: Floats, lag: int) -> float:
    """Return sum early[k - lag] late[k]."""
    if lag < 0:
        return correlate_at_lag(late, early, -lag)
    return float(early[: early.size - lag] @ late[lag:]) if lag < early.size else 0.0


@dataclass(frozen=True, eq=False)
class Phases:
    """The rows (N,) of a residual by their place in the period of the input.

    `index` (N,) is the place of each row. `counts` (P,) is the number of rows at each place, at least 2. `kept` (N,)
    marks the rows at places with two or more rows.
    """

    index: Places
    counts: Floats
    kept: Flags

    def mean(self, columns: Floats) -> Floats:
        """Return the mean (P, c) over the periods of columns (N, c) at the kept rows."""
        return np.asarray(self.sum(columns) / self.counts[:, None])

    def sum(self, columns: Floats) -> Floats:
        """Return the sum (P, c) over the periods of columns (N, c) at the kept rows."""
        found = np.zeros((self.counts.size, columns.shape[1]))
        np.add.at(found, self.index[self.kept], columns[self.kept])
        return found


def period_of(u: Floats) -> int | None:
    """Return the number of samples after which u (M,) repeats to its end, for at least two periods, or None."""
    change = np.flatnonzero(np.abs(np.diff(u)) > 0)
    if not change.size:
        return None
    limit, first = TUNING.residuals_same * float(np.ptp(u)), max(0, int(change[0]) + 1 - TUNING.residuals_look)
    look = u[first : first + 2 * TUNING.residuals_look]
    windows = np.lib.stride_tricks.sliding_window_view(u[first:], look.size)
    for period in np.flatnonzero(np.all(np.abs(windows - look) <= limit, axis=1)):
        if 1 < period <= u.size // 2 and np.all(np.abs(u[period:] - u[:-period]) <= limit):
            return int(period)
    return None


def phases_of(stretches: Sequence[RecordStretch], unknowns: int) -> Phases | None:
    """Return the phases of the rows of all stretches.

    The result is None if a stretch has no period or too short a period, or if no stretch has two periods.
    """
    index, start = [], 0
    for stretch in stretches:
        period = period_of(stretch.inputs[0]) if stretch.grid.uniform else None
        if period is None or period < unknowns + TUNING.residuals_least:
            return None
        index.append(start + stretch.rows % period)
        start += period
    places = np.concatenate(index)
    counts = np.bincount(places, minlength=start)
    used = np.flatnonzero(counts > 1)
    if used.size < unknowns + TUNING.residuals_least:
        return None
    number = np.full(start, -1)
    number[used] = np.arange(used.size)
    kept = counts[places] > 1
    return Phases(np.asarray(number[places]), counts[used].astype(float), kept)


def split(error: Floats, phases: Phases) -> tuple[Floats, Floats]:
    """Return the periodic part (P,) of a residual (N,), and the rest (N,), scaled to the size of the noise."""
    again = phases.mean(error[:, None])[:, 0]
    rest = error.copy()
    count = phases.counts[phases.index[phases.kept]]
    rest[phases.kept] = (error[phases.kept] - again[phases.index[phases.kept]]) * np.sqrt(count / (count - 1))
    return again, rest


def repeats(error: Floats, known: Floats, stretches: Sequence[RecordStretch], phases: Phases, place: Places) -> bool:
    """Return whether a residual (N,) has a larger periodic part than noise and errors of the parameters explain.

    The residual has rising places (N,), and `known` (N, p) holds the effects of the parameters. Loud noise at one
    frequency causes errors of the parameters at other frequencies.

    The periodic part lies on the harmonics of the period, and noise lies on all lines. The test compares each harmonic
    with its neighbouring lines after a whitening filter, which comes from the part that differs between periods.
    Finally, the test combines the probabilities of all harmonics (Fisher 1932). Therefore the test tolerates a narrow
    resonance of the noise that is not quite whitened.
    """
    from scipy.special import chdtrc  # slow to import

    noise: Noise = fit_noise(split(error, phases)[1], place)
    columns = whiten_columns(noise, np.column_stack([error, known]), place)
    size = np.linalg.norm(columns, axis=0)
    effects = columns[:, 1:] / np.where(size > 0, size, 1.0)[1:]
    white = columns[:, 0] - effects @ np.linalg.lstsq(effects, columns[:, 0], rcond=TUNING.residuals_rcond)[0]
    ends = np.cumsum([stretch.rows.size for stretch in stretches])
    parts = zip(stretches, np.split(white, ends[:-1]), strict=True)
    evidence = np.concatenate([_evidence(stretch, part) for stretch, part in parts])
    return bool(evidence.size and chdtrc(2 * evidence.size, float(np.sum(evidence))) < TUNING.residuals_chance)


def _evidence(stretch: RecordStretch, white: Floats) -> Floats:
    """Return -2 log p for each harmonic (K,), where p is the probability that noise has at least its power."""
    period = period_of(stretch.inputs[0]) or stretch.grid.size
    times = stretch.grid.size // period
    line = np.zeros(stretch.grid.size)
    line[stretch.rows] = white
    power = np.abs(np.fft.rfft(line[stretch.grid.size - times * period :])) ** 2
    numbers = np.arange(power.size)
    between = (numbers % times > 0).astype(float)
    near = np.ones(2 * max(times, TUNING.residuals_around) + 1)
    count = np.convolve(between, near, "same")
    level = np.convolve(between * power, near, "same") / np.maximum(count, 1.0)
    harmonics = numbers[times:-1:times]
    harmonics = harmonics[(count[harmonics] > 0) & (level[harmonics] > 0)]
    many = count[harmonics]
    return np.asarray(2 * many * np.log1p(power[harmonics] / level[harmonics] / many))


def prewhiten_problem(problem: ProcessProblem, noise: Noise) -> ProcessProblem:
    """Return the whitened problem, or the problem itself if steps are uneven or too few samples have a whole past.

    The offset of the whitened problem is multiplied by the sum of the filter's weights.
    """
    weights = noise.whitener
    if weights.size == 1 or not all(stretch.grid.uniform for stretch in problem.stretches):
        return problem
    found = [_whiten_stretch(stretch, weights) for stretch in problem.stretches]
    least = 2 * problem.structure.size
    usable = tuple(stretch for stretch in found if stretch is not None and stretch.rows.size > least)
    if sum(s.rows.size for s in usable) < TUNING.residuals_kept * sum(s.rows.size for s in problem.stretches):
        return problem
    return replace(problem, stretches=usable)


def _whiten_stretch(stretch: RecordStretch, weights: Floats) -> RecordStretch | None:
    from scipy.signal import lfilter  # SciPy is slow to import, and only transfer functions need this module.

    lost = weights.size - 1
    if stretch.grid.size < lost + 2:
        return None
    measured = np.zeros(stretch.grid.size)
    measured[stretch.rows] = 1.0
    whole = lfilter(np.ones(weights.size), [1.0], measured)[stretch.rows] > lost + 0.5
    return replace(
        stretch,
        grid=Grid(stretch.grid.steps, stretch.grid.size - lost),
        inputs=np.asarray(lfilter(weights, [1.0], stretch.inputs, axis=1))[:, lost:],
        y=np.asarray(lfilter(weights, [1.0], stretch.y))[lost:],
        rows=stretch.rows[whole] - lost,
        samples=stretch.samples[whole],
    )


def places(problem: ProcessProblem) -> Places:
    """Return the positions (N,) of the measured samples of all stretches on one line of even steps."""
    found, start = [], 0
    for stretch in problem.stretches:
        found.append(start + stretch.rows)
        start += stretch.grid.size + TUNING.residuals_apart
    return np.concatenate(found).astype(np.int64)


def residual_noise(problem: ProcessProblem, point: ProcessPoint) -> Noise:
    """Return the noise model of the residual at a point of the iteration."""
    size = np.linalg.norm(point.zeta, axis=0)
    Q = np.linalg.qr(point.zeta / np.where(size > 0, size, 1.0))[0]
    return fit_noise(point.error, places(problem), [(slice(None), Q), *point.projected])


def score_covariance(zeta: Floats, error: Floats, place: Places | None = None, projected: Removed = ()) -> Floats:
    """Return the covariance (p, p) of zeta^T v, where v is the noise.

    The columns of zeta (N, p) have similar sizes. The error (N,) is the part of v that the fit along zeta leaves, at
    places (N,). If `place` is None, the samples follow one another without gaps. `projected` holds the columns of the
    initial conditions, which the fit removed before.
    """
    place = np.arange(error.size) if place is None else place
    Q, R = np.linalg.qr(zeta)
    noise = fit_noise(error, place, [(slice(None), Q), *projected])
    removed = zeta.shape[1] + sum(columns.shape[1] for _, columns in projected)
    free = max(noise.effective(error.size) - removed, TUNING.least_free)
    return np.asarray(free / (free - 2) * (R.T @ noise.covariance(Q, place) @ R))


def covariance(point: ProcessPoint, problem: ProcessProblem) -> Floats:
    """Return the covariance (p, p) of theta after convergence, in the problem's units."""
    size = np.linalg.norm(point.zeta, axis=0)
    zeta = point.zeta / size
    inverse = np.linalg.inv(zeta.T @ (point.phi / size))
    spread = _spread(zeta, point, problem)
    return np.asarray(inverse @ spread @ inverse.T / np.outer(size, size))


def residual_repeats(problem: ProcessProblem, point: ProcessPoint) -> bool:
    """Return whether a part of the residual at a point repeats in every period of the input, by more than chance."""
    unknowns = point.zeta.shape[1]
    phases = phases_of(problem.stretches, unknowns)
    return phases is not None and repeats(point.error, point.zeta, problem.stretches, phases, places(problem))


def _spread(zeta: Floats, point: ProcessPoint, problem: ProcessProblem) -> Floats:
    """Return the covariance (p, p) of the scores.

    The periodic part of the residual contributes a separate covariance.
    """
    place, unknowns, error = places(problem), zeta.shape[1], point.error
    phases = phases_of(problem.stretches, unknowns)
    if phases is None or not repeats(error, zeta, problem.stretches, phases, place):
        return score_covariance(zeta, error, place, point.projected)
    again, rest = split(error, phases)
    return score_covariance(zeta, rest, place, point.projected) + score_covariance(phases.sum(zeta), again)
