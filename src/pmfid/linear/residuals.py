"""Coloured residuals: their model, tests, and the covariance of an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from pmfid.linear.experiment import Grid, RecordStretch
from pmfid.linear.solve import ProcessPoint, ProcessProblem
from pmfid.linear.tuning import TUNING
from pmfid.types import Flags, Floats, Places


@dataclass(frozen=True, eq=False)
class Noise:
    """v[t] = sum_j coefficients[j-1] v[t-j] + w[t], w white: coefficients (k,), variance of w, power of v."""

    coefficients: Floats
    variance: float
    power: float

    @property
    def whitener(self) -> Floats:
        """(k + 1,) weights of v[t], v[t-1], ... that give w[t]."""
        return np.asarray(np.r_[1.0, -self.coefficients])

    def effective(self, samples: int) -> float:
        """Number of samples of white noise whose correlations would be as uncertain as these (Bartlett 1935)."""
        spectrum = self._spectrum(TUNING.residuals_effective)
        return samples * float(np.mean(spectrum) ** 2 / np.mean(spectrum**2))

    def covariance(self, weights: Floats, place: Places) -> Floats:
        """Covariance (p, p) of sum_t weights[t] v[place[t]], weights (N, p), at rising places (N,)."""
        laid = np.fft.rfft(_place_on_line(weights, place, size := _size(place)), axis=0)
        twice = np.full(laid.shape[0], 2.0)
        twice[0] = twice[-1] = 1.0
        weighted = laid * (twice * self._spectrum(size))[:, None]
        return np.asarray((laid.conj().T @ weighted).real / size)

    def times(self, weights: Floats, place: Places) -> Floats:
        """The noise's covariance matrix times weights (N, p): (N, p)."""
        size = _size(place)
        laid = np.fft.rfft(_place_on_line(weights, place, size), axis=0)
        response = np.fft.irfft(laid * self._spectrum(size)[:, None], size, axis=0)
        return np.asarray(response[place - place[0]])

    def _spectrum(self, size: int) -> Floats:
        return np.asarray(self.variance / np.abs(np.fft.rfft(self.whitener, size)) ** 2)


def fit_noise(error: Floats, place: Places, taken: Floats | None = None) -> Noise:
    """Of a residual (N,) at rising places (N,), its order by Akaike's criterion with the correction of Hurvich and Tsai
    (1989). taken: orthonormal columns (N, q) which a fit took out of the noise, not necessarily all of them: their
    expected part of each autocovariance is put back."""
    most = min(TUNING.residuals_most, max(1, error.size // TUNING.residuals_part))
    laid, there = _place_on_line(error, place, _size(place)), _place_on_line(np.ones(error.size), place, _size(place))
    pairs = np.maximum(_autocovariance(there, most), 1e-9)
    # divided by one number, not by the count of pairs: else it need not be the covariance of anything, and lines appear
    raw = _autocovariance(laid, most) / pairs[0]
    if pairs[0] - pairs[1] > TUNING.residuals_gaps * error.size and np.any(
        np.abs(raw[1 : TUNING.residuals_soon]) > 4 * raw[0] / np.sqrt(error.size)
    ):
        raw = _correlate_over_gaps(error, place, most)
    noise = _from_autocovariance(raw, error.size)
    if taken is None or taken.shape[1] == 0:
        return noise
    for _ in range(TUNING.residuals_passes):
        put_back = raw + _compute_fit_effect(noise, taken, place, most) / pairs[0]
        if not put_back[0] < TUNING.residuals_largest * raw[0]:
            break
        noise = _from_autocovariance(put_back, error.size)
    return noise


def whiten_columns(noise: Noise, columns: Floats, place: Places) -> Floats:
    """Columns (N, c) after the whitening filter, missing samples as zeros: (N, c)."""
    laid = _place_on_line(columns, place, int(place[-1] - place[0]) + 1)
    result = laid.copy()
    for lag, value in enumerate(noise.coefficients, start=1):
        result[lag:] -= value * laid[:-lag]
    return np.asarray(result[place - place[0]])


def _compute_fit_effect(noise: Noise, taken: Floats, place: Places, most: int) -> Floats:
    """(most + 1,) by how much less sum e[t] e[t+k] of a residual is expected than of its noise: with the projection
    1 - Q Q^T and the shift S the traces of 2 Q^T S R Q - Q^T S Q Q^T R Q."""
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
    """(most + 1,) autocovariance with straight lines over short gaps: sums over different pairs differ by more than
    the variance that a prediction of slow noise leaves, and no model follows from them."""
    line = np.arange(int(place[-1] - place[0]) + 1) + place[0]
    nearest = np.searchsorted(place, line)
    long = place[nearest] - np.r_[place[0], place][nearest] > most
    filled = np.where(long & ~np.isin(line, place), 0.0, np.interp(line, place, error))
    found = _autocovariance(filled, most)
    return np.asarray(found / found[0] * float(error @ error) / error.size)


def _from_autocovariance(r: Floats, samples: int) -> Noise:
    """Levinson's recursion; an order whose reflection is 1 or more is none, and ends it."""
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
    """Columns (N, ...) on the line, zeros where nothing is."""
    line = np.zeros((size, *columns.shape[1:]))
    line[place - place[0]] = columns
    return line


def _size(place: Places) -> int:
    """The size of a transform in which the end of the line does not reach its beginning."""
    return 1 << int(2 * (place[-1] - place[0]) + TUNING.residuals_round).bit_length()


def is_white(error: Floats) -> bool:
    """Whether so few autocorrelations of a residual (n,) are beyond their bounds that chance explains them."""
    power = max(float(error @ error), 1e-300)
    auto = np.array([correlate_at_lag(error, error, lag) for lag in range(1, TUNING.residuals_lags + 1)]) / power
    return few_beyond(auto, TUNING.residuals_deviate / float(np.sqrt(max(error.size, 1))))


def few_beyond(correlations: Floats, bound: float) -> bool:
    """Whether chance explains how many of the correlations (k,) are beyond a bound of 99 %."""
    return int(np.sum(np.abs(correlations) > bound)) <= 3


def correlate_at_lag(early: Floats, late: Floats, lag: int) -> float:
    """sum early[k - lag] late[k]."""
    if lag < 0:
        return correlate_at_lag(late, early, -lag)
    return float(early[: early.size - lag] @ late[lag:]) if lag < early.size else 0.0


@dataclass(frozen=True, eq=False)
class Phases:
    """Rows (N,) of a residual by their place in the period. index (N,): place of each row; counts (P,): rows at each
    place, all 2 or more; kept (N,): rows whose place has such a count."""

    index: Places
    counts: Floats
    kept: Flags

    def mean(self, columns: Floats) -> Floats:
        """(P, c) over the periods of columns (N, c) at the kept rows."""
        return np.asarray(self.sum(columns) / self.counts[:, None])

    def sum(self, columns: Floats) -> Floats:
        """(P, c) of the same."""
        found = np.zeros((self.counts.size, columns.shape[1]))
        np.add.at(found, self.index[self.kept], columns[self.kept])
        return found


def period_of(u: Floats) -> int | None:
    """Samples after which u (M,) repeats itself, to the end, for at least two periods; None if it does not."""
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
    """Of the rows of all stretches; None if one has no period, or too short a one, or none has two of them."""
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
    """The part (P,) of a residual (N,) that repeats, and the rest (N,), as large as the noise is."""
    again = phases.mean(error[:, None])[:, 0]
    rest = error.copy()
    count = phases.counts[phases.index[phases.kept]]
    rest[phases.kept] = (error[phases.kept] - again[phases.index[phases.kept]]) * np.sqrt(count / (count - 1))
    return again, rest


def repeats(error: Floats, known: Floats, stretches: Sequence[RecordStretch], phases: Phases, place: Places) -> bool:
    """Is more of a residual (N,) at rising places (N,) the same in every period than noise of its colour explains, and
    errors of the parameters, known (N, p) their effects? Loud noise at one frequency makes those elsewhere.

    What repeats lies on the harmonics of the period and noise on all lines: each harmonic is compared with the lines
    around it, after the whitening filter of what differs between periods, and the chances of all are taken together
    (Fisher 1932): so it does no harm if a narrow resonance of the noise is not quite whitened."""
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
    """(K,) for each harmonic -2 log of the chance of noise to have as much there."""
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
    """The filtered problem, whose offset is smaller by the sum of the filter's weights. The problem itself, if steps
    are uneven or too few samples have a whole past."""
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
    from scipy.signal import lfilter  # slow to import, and only transfer functions need it

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
    """(N,) positions of the measured samples of all stretches on one line of even steps."""
    found, start = [], 0
    for stretch in problem.stretches:
        found.append(start + stretch.rows)
        start += stretch.grid.size + TUNING.residuals_apart
    return np.concatenate(found).astype(np.int64)


def residual_noise(problem: ProcessProblem, point: ProcessPoint) -> Noise:
    """The colour of what a point of the iteration leaves."""
    size = np.linalg.norm(point.zeta, axis=0)
    Q = np.linalg.qr(point.zeta / np.where(size > 0, size, 1.0))[0]
    return fit_noise(point.error, places(problem), Q)


def score_covariance(zeta: Floats, error: Floats, place: Places | None = None) -> Floats:
    """(p, p) of sum zeta v; zeta (N, p) of about one size, error (N,) with what the fit along zeta left of v, at places
    (N,); None: one after the other."""
    place = np.arange(error.size) if place is None else place
    Q, R = np.linalg.qr(zeta)
    noise = fit_noise(error, place, Q)
    free = max(noise.effective(error.size) - zeta.shape[1], TUNING.least_free)
    return np.asarray(free / (free - 2) * (R.T @ noise.covariance(Q, place) @ R))


def covariance(point: ProcessPoint, problem: ProcessProblem) -> Floats:
    """(p, p) of theta at a point where the iteration has settled, in the problem's units."""
    size = np.linalg.norm(point.zeta, axis=0)
    zeta = point.zeta / size
    inverse = np.linalg.inv(zeta.T @ (point.phi / size))
    spread = _spread(zeta, point.error, problem)
    return np.asarray(inverse @ spread @ inverse.T / np.outer(size, size))


def residual_repeats(problem: ProcessProblem, point: ProcessPoint) -> bool:
    """Does a part of the residual at a point repeat in every period of the input, by more than chance?"""
    unknowns = point.zeta.shape[1]
    phases = phases_of(problem.stretches, unknowns)
    return phases is not None and repeats(point.error, point.zeta, problem.stretches, phases, places(problem))


def _spread(zeta: Floats, error: Floats, problem: ProcessProblem) -> Floats:
    """(p, p) of the scores, of what repeats apart from what does not, where it does."""
    place, unknowns = places(problem), zeta.shape[1]
    phases = phases_of(problem.stretches, unknowns)
    if phases is None or not repeats(error, zeta, problem.stretches, phases, place):
        return score_covariance(zeta, error, place)
    again, rest = split(error, phases)
    return score_covariance(zeta, rest, place) + score_covariance(phases.sum(zeta), again)
