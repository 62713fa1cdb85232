"""Checks for time stamps that contradict the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pmfid.diagnostics.drives import counts_per_sample
from pmfid.estimators.stretches import liveliest
from pmfid.findings import Finding
from pmfid.pipeline.checks.view import CheckedLog, View, hasty, view, with_friction
from pmfid.pipeline.guess.columns import step_of
from pmfid.pipeline.tuning import TUNING
from pmfid.types import Counts, Floats

__all__ = ["Drift", "drift_of"]


@dataclass(frozen=True)
class Drift:
    """A drift between the clocks of input and output.

    `samples` is the shift of the input against the output over `rows` rows. A positive shift means a later input.
    `sure` is the shift in standard deviations. `less` is the ratio of the unexplained power with drift to the
    unexplained power without drift.
    """

    samples: float
    rows: int
    sure: float
    less: float

    @property
    def rate(self) -> float:
        """The drift per row [samples]."""
        return self.samples / self.rows


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over each of timing_pieces pieces of a record.

    `gram` (k, p, p) holds products of the columns. `cross` (k, s, p) holds products of the columns with the input at
    each shift. `power` (k, s) is the power of the input.
    """

    gram: Floats
    cross: Floats
    power: Floats

    def drop_piece(self, piece: int) -> _Sums:
        keep = np.arange(len(self.gram)) != piece
        return _Sums(self.gram * keep[:, None, None], self.cross * keep[:, None, None], self.power * keep[:, None])

    def measure_rest(self, shifts: Floats) -> Floats:
        """Return the part (m,) of the input's power that remains unexplained if piece k is shifted by shifts (m, k)."""
        low = np.clip(np.floor(shifts).astype(int) + TUNING.largest_shift, 0, 2 * TUNING.largest_shift - 1)
        part = np.clip(shifts + TUNING.largest_shift - low, 0.0, 1.0)
        rows = np.arange(len(self.gram))
        cross = (1 - part)[..., None] * self.cross[rows, low] + part[..., None] * self.cross[rows, low + 1]
        power = (1 - part) * self.power[rows, low] + part * self.power[rows, low + 1]
        total, together = power.sum(axis=1), cross.sum(axis=1)
        theta = np.linalg.pinv(self.gram.sum(axis=0), rcond=1e-10, hermitian=True) @ together.T
        return np.asarray((total - np.sum(theta.T * together, axis=1)) / np.maximum(total, 1e-300))


def drift_of(view: View) -> Drift | None:
    """Return the drift between input and output that explains the record best, or None if the record is too short."""
    n = view.z.size - 2 * TUNING.largest_shift
    if n < TUNING.timing_pieces * TUNING.timing_least * TUNING.largest_shift:
        return None
    sums = _sums(view, n)
    whole, best, least = _best(sums)
    others = np.array([_best(sums.drop_piece(piece))[0] for piece in range(TUNING.timing_pieces)])
    spread = np.sqrt(
        (TUNING.timing_pieces - 1) / TUNING.timing_pieces * np.sum((others - others.mean()) ** 2)
        + TUNING.timing_step**2 / 12
    )
    return Drift(whole, n, abs(whole) / float(spread), best / max(least, 1e-300))


def _best(sums: _Sums) -> tuple[float, float, float]:
    """Return the best drift [samples], its unexplained part, and the least unexplained part without drift."""
    drifts = np.arange(-TUNING.timing_furthest, TUNING.timing_furthest + TUNING.timing_step, TUNING.timing_step)
    middles = np.arange(-TUNING.largest_shift / 2, TUNING.largest_shift / 2 + 1)
    places = (np.arange(TUNING.timing_pieces) + 0.5) / TUNING.timing_pieces - 0.5
    shifts = middles[:, None, None] + drifts[None, :, None] * places
    left = sums.measure_rest(shifts.reshape(-1, TUNING.timing_pieces)).reshape(middles.size, drifts.size)
    _, column = np.unravel_index(int(np.argmin(left)), left.shape)
    return float(drifts[column]), float(left.min()), float(left[:, drifts.size // 2].min())


def _sums(view: View, n: int) -> _Sums:
    B = with_friction(view)[TUNING.largest_shift : TUNING.largest_shift + n]
    size = np.linalg.norm(B, axis=0)
    B = B[:, size > 0] / size[size > 0]
    shifted = np.lib.stride_tricks.sliding_window_view(view.z, n)[::-1]  # row s is later by s - largest_shift samples
    edges = np.linspace(0, n, TUNING.timing_pieces + 1).astype(int)
    pairs = list(pairwise(edges))
    gram = np.array([B[a:b].T @ B[a:b] for a, b in pairs])
    cross = np.array([shifted[:, a:b] @ B[a:b] for a, b in pairs])
    power = np.array([np.sum(shifted[:, a:b] ** 2, axis=1) for a, b in pairs])
    return _Sums(gram, cross, power)


def too_slow(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the velocity changes by much of its size within a sample period.

    The steps of a coarse sensor, which may be many counts, change the velocity as well, and say nothing.
    """
    change = np.diff(log.known.counts)
    moving = np.abs(change[change != 0])
    if moving.size < 2 or float(np.median(moving)) < TUNING.timing_fine:
        return
    if float(np.median(moving)) < TUNING.timing_fine * step_of(log.known.counts.astype(np.float64))[0]:
        return
    jumps = hasty(change)
    if not (jumps > TUNING.timing_hasty or (jumps > TUNING.timing_rather and _misses_input(log))):
        return
    yield Finding(
        "rate_low",
        f"the velocity changes by {100 * jumps:.0f} % of its size from row to row",
        f"make a new record at a sample period of at most {log.record.dt / 10 / min(jumps, 2):.1g} s",
        detail=f"With a sample period of {log.record.dt:g} s the record misses most of the motion.",
    )


def _misses_input(log: CheckedLog) -> bool:
    """Return whether the logged input fails to explain the changes of velocity in a short record."""
    change, u = np.diff(log.known.counts).astype(np.float64), log.known.u
    turn, velocity = np.diff(change), (change[1:] + change[:-1]) / 2
    if (
        log.view is not None
        or not log.is_machine
        or turn.size < TUNING.timing_rows
        or np.std(turn) < TUNING.timing_counts
    ):
        return False
    causes = np.column_stack([u[:-2], u[1:-1], velocity, np.sign(velocity), np.ones(turn.size)])
    left = turn - causes @ np.linalg.lstsq(causes, turn, rcond=None)[0]
    return bool(np.linalg.norm(left) > TUNING.timing_astray * np.linalg.norm(turn - turn.mean()))


def too_fast(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the count hardly ever changes within a sample period."""
    per_sample = counts_per_sample(log.known.counts)
    if 0 < per_sample < TUNING.timing_idle:
        keep = max(2, round(TUNING.timing_plenty / per_sample))
        yield Finding(
            "rate_high",
            f"the axis moves {per_sample:.2g} counts per row, so nearly all rows repeat the last count",
            f"keep every {keep}th row, with the mean of the input over this row and the next {keep - 1}",
        )


def odd_period(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding for a `dt` that no usual log has, at which the velocity also changes as no machine's does.

    The unit of a time column is checked on reading.
    """
    dt = log.record.dt
    if not log.is_machine or log.axis.record.time is not None:
        return
    hurry = hasty(np.diff(log.known.counts))
    per_row = counts_per_sample(log.known.counts)
    slow = dt >= TUNING.axis_file_longest and dt > TUNING.timing_slowest * hurry
    fast = dt < TUNING.axis_file_shortest and dt < TUNING.timing_fastest * hurry and per_row >= 1
    if not (hurry > 0 and (slow or fast)):
        return
    yield Finding(
        "odd_period",
        f"with a sample period of {dt:.6g} s and {per_row:.3g} counts per row, the velocity takes {dt / hurry:.3g} s "
        f"to change, which is unusually {'long' if slow else 'short'} for a machine",
        "dt is in s: give " + (f"{dt / 1e3:.6g} if {dt:.6g} ms was meant" if slow else "the time between two rows"),
    )


def drifts(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the input has another clock than the output."""
    if not log.is_machine or log.view is None or log.elastic:  # a resonance turns the phase as a drift does
        return
    rate, n = _drift(log), log.record.u.size
    if rate == 0:
        return
    yield Finding(
        "drift",
        f"input and output have two clocks, which drift apart by {abs(rate) * n:.2g} rows in {n} rows",
        f"log both with one clock, or multiply the input's time by {1 + rate:.6f} and use its latest value in each row",
        detail="With this drift corrected, the motion explains the input better.",
    )


def _drift(log: CheckedLog) -> float:
    """Return the most significant drift per row, or 0 if no drift is significant.

    Repeated corrections refine large drifts.
    """
    part = liveliest(log.known.counts, TUNING.timing_most_samples)
    u, counts = log.force[part], log.known.counts[part]
    first = _surest(log, u, counts)
    if first is None:
        return 0.0
    rate = first.rate
    for _ in range(TUNING.timing_corrections):
        further = _surest(log, _resample_input(u, rate), counts)
        if further is None or abs(rate + further.rate) > TUNING.timing_most * abs(first.rate):
            break
        rate += further.rate
    return rate


def _resample_input(u: Floats, rate: float) -> Floats:
    """Return the input (n,), held between its rows, at the rows of an output against which the input drifts."""
    rows = np.arange(u.size) / (1 + rate)
    return np.asarray(u[np.minimum(rows, u.size - 1).astype(int)])


def _is_better(drift: Drift) -> bool:
    """Return whether the drift explains the record better than no drift.

    The true drift may exceed the largest tried drift. Therefore the largest tried drift must explain more than others.
    """
    furthest = abs(drift.samples) >= TUNING.timing_furthest
    return drift.less < (TUNING.timing_less_furthest if furthest else TUNING.timing_less)


def _surest(log: CheckedLog, u: Floats, counts: Counts) -> Drift | None:
    views = [view(u, counts, log.encoder, log.record.dt, time) for time in TUNING.drift_times]
    found = [drift for one in views if one is not None and (drift := drift_of(one)) is not None]
    sure = [
        one
        for one in found
        if abs(one.samples) >= TUNING.timing_drifted and one.sure > TUNING.timing_sure and _is_better(one)
    ]
    return max(sure, key=lambda one: one.sure, default=None)
