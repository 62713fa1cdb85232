"""Clocks: a sample rate that does not suit the axis, an input with another clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.findings import Finding
from pmfid.judge.counts import counts_per_sample
from pmfid.session.checks.log import CheckedLog, hasty, liveliest
from pmfid.session.checks.shift import Drift, drift_of
from pmfid.session.checks.view import view
from pmfid.types import Counts, Floats

__all__ = ["drifts", "too_fast", "too_slow"]

#: Change of the velocity from sample to sample, as a part of the velocity, above which samples miss the motion; counts
#: per sample above which this change is not due to the encoder.
HASTY, FINE = 0.42, 3.0
#: The same in records too short for filters; part of the change that the logged input leaves unexplained; least
#: standard deviation of the change [counts]; least rows.
RATHER, ASTRAY, COUNTS, ROWS = 0.25, 0.5, 10.0, 12
#: Counts per sample below which most samples carry no information; counts per sample that suffice.
IDLE, PLENTY = 0.02, 0.2
#: Time constants of the filters that show a drift [samples]; of a drift the least size [samples], the least size in
#: standard deviations, and the largest ratio of the unexplained parts with and without it.
DRIFT_TIMES, DRIFTED, SURE, LESS = (10.0, 30.0, 100.0), 1.5, 4.5, 0.95
#: Most further corrections; largest corrected drift, as a multiple of the first.
CORRECTIONS, MOST = 3, 1.5
#: Samples that are searched for a drift.
MOST_SAMPLES = 40_000


def too_slow(log: CheckedLog) -> Iterator[Finding]:
    """A sample period within which the velocity changes by much of its size."""
    change = np.diff(log.known.counts)
    moving = np.abs(change[change != 0])
    if moving.size < 2 or float(np.median(moving)) < FINE:
        return
    jumps = hasty(change)
    if not (jumps > HASTY or (jumps > RATHER and _misses_input(log))):
        return
    yield Finding(
        "rate_low",
        f"the velocity changes by {100 * jumps:.0f} % of its size from row to row: with a sample period of "
        f"{log.record.dt:g} s the record misses most of the motion",
        f"make a new record at a sample period of at most {log.record.dt / 10 / min(jumps, 2):.1g} s",
    )


def _misses_input(log: CheckedLog) -> bool:
    """Does the velocity of a short record change in a way that the logged input does not explain?"""
    change, u = np.diff(log.known.counts).astype(np.float64), log.known.u
    turn, velocity = np.diff(change), (change[1:] + change[:-1]) / 2
    if log.view is not None or not log.is_machine or turn.size < ROWS or np.std(turn) < COUNTS:
        return False
    causes = np.column_stack([u[:-2], u[1:-1], velocity, np.sign(velocity), np.ones(turn.size)])
    left = turn - causes @ np.linalg.lstsq(causes, turn, rcond=None)[0]
    return bool(np.linalg.norm(left) > ASTRAY * np.linalg.norm(turn - turn.mean()))


def too_fast(log: CheckedLog) -> Iterator[Finding]:
    """A sample period within which the count hardly ever changes."""
    per_sample = counts_per_sample(log.known.counts)
    if 0 < per_sample < IDLE:
        keep = max(2, round(PLENTY / per_sample))
        yield Finding(
            "rate_high",
            f"the axis moves {per_sample:.2g} counts per row: nearly all rows say nothing, and filters as slow as the "
            "motion are long",
            f"keep every {keep}th row, with the mean of the input over the {keep} rows from it on",
        )


def drifts(log: CheckedLog) -> Iterator[Finding]:
    """An input with another clock than the output."""
    if not log.is_machine or log.view is None:
        return
    rate, n = _drift(log), log.record.u.size
    if rate == 0:
        return
    yield Finding(
        "drift",
        f"the input moves against the output by {abs(rate) * n:.2g} rows within {n}, for then the motion explains "
        "it better throughout: they are of two clocks",
        f"log both by one clock, or multiply the time of the input by {1 + rate:.6f} and take the latest "
        "one at each time of the output",
    )


def _drift(log: CheckedLog) -> float:
    """The most significant drift per row, 0 if none is significant. Corrections refine the drift, which large drifts
    need."""
    part = liveliest(log.known.counts, MOST_SAMPLES)
    u, counts = log.force[part], log.known.counts[part]
    first = _surest(log, u, counts)
    if first is None:
        return 0.0
    rate = first.rate
    for _ in range(CORRECTIONS):
        further = _surest(log, _resample_input(u, rate), counts)
        if further is None or abs(rate + further.rate) > MOST * abs(first.rate):
            break
        rate += further.rate
    return rate


def _resample_input(u: Floats, rate: float) -> Floats:
    """The input (n,), held between its rows, at the rows of an output against which it drifts by a rate."""
    rows = np.arange(u.size) / (1 + rate)
    return np.asarray(u[np.minimum(rows, u.size - 1).astype(int)])


def _surest(log: CheckedLog, u: Floats, counts: Counts) -> Drift | None:
    views = [view(u, counts, log.encoder, log.record.dt, time) for time in DRIFT_TIMES]
    found = [drift for one in views if one is not None and (drift := drift_of(one)) is not None]
    sure = [one for one in found if abs(one.samples) >= DRIFTED and one.sure > SURE and one.less < LESS]
    return max(sure, key=lambda one: one.sure, default=None)
