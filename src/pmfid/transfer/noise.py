"""The colour of a residual: an autoregressive model of it, and what follows for sums over the noise.

A fit takes from the noise what its sensitivities can follow, the slow part above all; the model is that of the noise
before the fit. Rows of a record are placed on a line of even steps, on which samples may be missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats, Places

#: Orders that are tried: up to this, and no more than a part of the samples.
MOST, PART = 40, 8
#: Passes that restore the part of the noise that the fit took, and the largest power, over the power of the residual.
PASSES, LARGEST = 3, 3.0
#: Part of the samples whose follower may be missing; lags that tell whether the noise is white.
GAPS, SOON = 0.02, 11
#: Frequencies over which a spectrum is averaged.
EFFECTIVE = 4096
#: Steps between the ends of a line and its beginning, on the circle of a transform, at least.
ROUND = 256


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
        spectrum = self._spectrum(EFFECTIVE)
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
    most = min(MOST, max(1, error.size // PART))
    laid, there = _place_on_line(error, place, _size(place)), _place_on_line(np.ones(error.size), place, _size(place))
    pairs = np.maximum(_autocovariance(there, most), 1e-9)
    # divided by one number, not by the count of pairs: else it need not be the covariance of anything, and lines appear
    raw = _autocovariance(laid, most) / pairs[0]
    if pairs[0] - pairs[1] > GAPS * error.size and np.any(np.abs(raw[1:SOON]) > 4 * raw[0] / np.sqrt(error.size)):
        raw = _correlate_over_gaps(error, place, most)
    noise = _from_autocovariance(raw, error.size)
    if taken is None or taken.shape[1] == 0:
        return noise
    for _ in range(PASSES):
        put_back = raw + _compute_fit_effect(noise, taken, place, most) / pairs[0]
        if not put_back[0] < LARGEST * raw[0]:
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
    """Of a transform in which the end of the line does not reach its beginning."""
    return 1 << int(2 * (place[-1] - place[0]) + ROUND).bit_length()
