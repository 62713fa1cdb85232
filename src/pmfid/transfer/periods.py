"""An input that repeats: what the residual does again in every period is an error of the model, the rest is noise.

Over R periods noise averages out and what repeats does not: a sum of R times the same is R times as large, not sqrt(R).
Standard errors that take a repeated error for noise are sqrt(R) too short. So both parts are separated phase by phase,
in time: nothing leaks, the start may be a steady state or not (initial conditions are part of every fit), and samples
may be missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.noise import Noise, fit_noise, whiten_columns
from pmfid.types import Flags, Floats, Places

#: Two periods are the same if no input differs by more than this part of its range.
SAME = 1e-6
#: Samples around the first change of the input that a period must show again, before all are compared.
LOOK = 4
#: Samples of a period, at least, beyond the parameters: else there is nothing left to tell from.
LEAST = 8
#: Lines on either side of a harmonic that it is compared with, at least, harmonics among them.
AROUND = 6
#: Effects of parameters that are combinations of others up to this part.
RCOND = 1e-7
#: The residual repeats where so few records without an error of the model would seem to.
CHANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Phases:
    """Rows (N,) of a residual by their place in the period: index (N,) of it, counts (P,) of the rows there, all 2 or
    more; kept (N,): rows whose place has them."""

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
    """Samples after which u (M,) repeats itself, to the end, for at least two periods; None where it does not."""
    change = np.flatnonzero(np.abs(np.diff(u)) > 0)
    if not change.size:
        return None
    limit, first = SAME * float(np.ptp(u)), max(0, int(change[0]) + 1 - LOOK)
    look = u[first : first + 2 * LOOK]
    windows = np.lib.stride_tricks.sliding_window_view(u[first:], look.size)
    for period in np.flatnonzero(np.all(np.abs(windows - look) <= limit, axis=1)):
        if 1 < period <= u.size // 2 and np.all(np.abs(u[period:] - u[:-period]) <= limit):
            return int(period)
    return None


def phases_of(stretches: Sequence[RecordStretch], unknowns: int) -> Phases | None:
    """Of the rows of all stretches; None where one has no period, or too short a one, or none has two of them."""
    index, start = [], 0
    for stretch in stretches:
        period = period_of(stretch.inputs[0]) if stretch.grid.uniform else None
        if period is None or period < unknowns + LEAST:
            return None
        index.append(start + stretch.rows % period)
        start += period
    places = np.concatenate(index)
    counts = np.bincount(places, minlength=start)
    used = np.flatnonzero(counts > 1)
    if used.size < unknowns + LEAST:
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
    white = columns[:, 0] - effects @ np.linalg.lstsq(effects, columns[:, 0], rcond=RCOND)[0]
    ends = np.cumsum([stretch.rows.size for stretch in stretches])
    parts = zip(stretches, np.split(white, ends[:-1]), strict=True)
    evidence = np.concatenate([_evidence(stretch, part) for stretch, part in parts])
    return bool(evidence.size and chdtrc(2 * evidence.size, float(np.sum(evidence))) < CHANCE)


def _evidence(stretch: RecordStretch, white: Floats) -> Floats:
    """(K,) for each harmonic -2 log of the chance of noise to have as much there."""
    period = period_of(stretch.inputs[0]) or stretch.grid.size
    times = stretch.grid.size // period
    line = np.zeros(stretch.grid.size)
    line[stretch.rows] = white
    power = np.abs(np.fft.rfft(line[stretch.grid.size - times * period :])) ** 2
    numbers = np.arange(power.size)
    between = (numbers % times > 0).astype(float)
    near = np.ones(2 * max(times, AROUND) + 1)
    count = np.convolve(between, near, "same")
    level = np.convolve(between * power, near, "same") / np.maximum(count, 1.0)
    harmonics = numbers[times:-1:times]
    harmonics = harmonics[(count[harmonics] > 0) & (level[harmonics] > 0)]
    many = count[harmonics]
    return np.asarray(2 * many * np.log1p(power[harmonics] / level[harmonics] / many))
