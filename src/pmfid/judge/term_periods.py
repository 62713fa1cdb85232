"""At which pitch does a force come again along the travel? Scans over pitches, and the pitches that they end at.

Two scans look at the same record in different ways. Score tests see what a force does to the position: where it is slow
against the encoder's error, but not where the simulated motion has left the measured one. A balance of forces behind
the filters sees it at the measured places, however far the simulation is off: where it is fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.adequacy import filtered_rows, weigh
from pmfid.estimators.configuration import change_arguments, like
from pmfid.estimators.difference import Difference, rms
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.lacks import Place
from pmfid.estimators.likelihood import Best
from pmfid.estimators.ls import LS
from pmfid.models.drive import Drive
from pmfid.types import Floats

#: Least and most pitches of the travel: with fewer a pitch is told from nothing else, more are not looked for.
FEWEST, MOST = 4.0, 150.0
#: Counts, and samples at the usual speed, that a pitch has at least.
COUNTS, SAMPLES = 8.0, 4.0
#: Pitches are tried half a pitch of the travel apart, so many at a time.
APART, AT_A_TIME = 0.5, 40
#: Peaks that are gone on from in each scan, and pitches of the travel between two of them.
PEAKS, BETWEEN = 2, 0.9
#: Around a peak they are tried this much apart.
CLOSER = np.arange(-0.4, 0.5, 0.1)
#: Cutoffs of the balance, as parts of the filters': the encoder's error hides a slow force behind fast filters, and
#: friction a fast one behind slow filters.
SLOWER = (1.0, 1 / 3)
#: Pitches that are looked at on the way are counted in hundreds, so that they are moved by a hundredth of one.
HUNDRED = 100.0


def pitches(best: Best) -> Floats:
    """(k,) how many pitches of a cogging force the travel may have; none where it is too short for any."""
    difference = replace(best.difference, parts=1)
    travel, v = float(np.ptp(difference.y)), difference.motion(best.q)[1]
    usual = rms(v[v != 0]) if np.any(v) else 0.0
    shortest = max(COUNTS * difference.resolution, SAMPLES * usual * difference.dt)
    return np.arange(FEWEST, min(MOST, travel / max(shortest, 1e-300)), APART)


def candidates(method: IntervalML, u: Floats, counts: NDArray[np.int64], best: Best) -> list[float]:
    """How many pitches of a cogging force the travel may have by the peaks of the scans, at a model's best fit to u,
    counts (n,)."""
    numbers = pitches(best)
    if not numbers.size:
        return []
    found = list(_peaks(numbers, lambda tried: _promised(best, tried)))
    for part in SLOWER:
        own = like(LS, method, model=method.model.simple, cutoff=part * method.cutoff)
        found += _peaks(numbers, lambda tried, own=own: balanced(own, u, counts, tried))  # type: ignore[misc]
    return apart(found)


def _peaks(numbers: Floats, gain_of: Callable[[Floats], Floats]) -> Iterator[float]:
    """The largest, each looked at more closely."""
    gain = gain_of(numbers)
    for _ in range(PEAKS):
        k = int(np.argmax(gain))
        if not gain[k] > 0:
            return
        near = numbers[k] + CLOSER
        yield float(near[int(np.argmax(gain_of(near)))])
        gain[np.abs(numbers - numbers[k]) < BETWEEN] = 0.0


def apart(numbers: Sequence[float]) -> list[float]:
    """Those that are not nearly another one before."""
    kept = list[float]()
    for number in numbers:
        if all(abs(number - other) > APART for other in kept):
            kept.append(number)
    return kept


def _promised(best: Best, numbers: Floats) -> Floats:
    """(k,) doubled gain of the log-likelihood of sin and cos together that their scores promise, about, for so many
    pitches of the travel."""
    coarse = replace(best, difference=replace(best.difference, parts=1))
    travel, gains = float(np.ptp(best.difference.y)), dict.fromkeys(numbers.tolist(), 0.0)
    for part in _parts(numbers):
        own = {travel / number: number for number in part.tolist()}
        found = weigh(coarse, [Place("cogging", period) for period in own])
        for lack, gain in zip(found.lacks, found.gain.tolist(), strict=True):
            if lack.name == "cogging":
                gains[own[float(lack.changes[0]["cogging"])]] += gain  # type: ignore[arg-type]
    return np.array(list(gains.values()))


def _parts(numbers: Floats) -> list[Floats]:
    return [numbers[first : first + AT_A_TIME] for first in range(0, numbers.size, AT_A_TIME)]


def balanced(method: LS, u: Floats, counts: NDArray[np.int64], numbers: Floats) -> Floats:
    """(k,) part of what a balance of forces behind the filters leaves, of u, counts (n,), that a force at the measured
    place with so many pitches of the travel explains beside the model's own terms."""
    columns, y = method.columns(u, counts), method.encoder.resolution * (counts - counts[0])
    middle = y + np.diff(y, append=y[-1]) / 2
    own = np.linalg.qr(columns.phi)[0]
    left, near = columns.z - own @ (own.T @ columns.z), math.ceil(1 / (method.cutoff * method.dt))
    moving = _moving(counts, near)
    found = []
    for part in _parts(numbers):
        angle = np.outer(2 * np.pi / np.ptp(y) * part, middle)
        waves = filtered_rows(moving * np.concatenate([np.sin(angle), np.cos(angle)]), method)[:, columns.used]
        waves -= (waves @ own) @ own.T
        sin, cos = waves[: part.size], waves[part.size :]
        a, b, both = np.sum(sin**2, axis=1), np.sum(cos**2, axis=1), np.sum(sin * cos, axis=1)
        ours, its = sin @ left, cos @ left
        found.append((b * ours**2 - 2 * both * ours * its + a * its**2) / np.maximum(a * b - both**2, 1e-9 * a * b))
    return np.asarray(np.concatenate(found) / float(left @ left))


def _moving(counts: NDArray[np.int64], near: int) -> NDArray[np.bool_]:
    """(n,) does the axis move, within so many samples? At rest friction takes whatever force there is."""
    moves = np.diff(counts, append=counts[-1]) != 0
    return np.asarray(np.convolve(moves, np.ones(2 * near + 1), "same") > 0)


@dataclass(frozen=True)
class Pitched(Difference):
    """A `Difference` as a function of q = (theta, x0, v0, number / HUNDRED) as well: how many pitches of the cogging
    force the travel has. model: of the equation, at any pitch."""

    model: Drive | None = None

    def at(self, q: Floats) -> Difference:
        """The difference at the pitch of q (q + 1,)."""
        own = {field.name: getattr(self, field.name) for field in fields(Difference)}
        return Difference(**(own | {"equation": self.model_at(q).equation}))

    def model_at(self, q: Floats) -> Drive:
        """The model at the pitch of q (q + 1,)."""
        if self.model is None:
            raise TypeError("a difference with a pitch needs the model that has it")
        return change_arguments(self.model, {"cogging": float(np.ptp(self.y) / (HUNDRED * q[-1]))})

    @property
    def number(self) -> float:
        """How many pitches of the model's own cogging force the travel has."""
        return float(np.ptp(self.y)) / float((self.model and self.model.cogging) or np.nan)

    def __call__(self, q: Floats) -> Floats:
        return self.at(q)(q[:-1])

    @property
    def lower(self) -> Floats:
        return np.asarray(np.r_[super().lower, FEWEST / 2 / HUNDRED])


def pitched(difference: Difference, model: Drive) -> Pitched:
    """The same difference, of a model with a cogging force, at any pitch."""
    own = {field.name: getattr(difference, field.name) for field in fields(Difference)}
    return Pitched(**own, model=model)
