"""Checks for sample periods that contradict the motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.diagnostics.drives import counts_per_sample
from pmfid.findings import Finding
from pmfid.pipeline.checks.view import CheckedLog, hasty
from pmfid.pipeline.guess.columns import step_of
from pmfid.records.clock import LONGEST_PLAIN_PERIOD, SHORTEST_PLAIN_PERIOD

#: Relative change of the velocity from sample to sample above which the sample period is too long. `TIMING_FINE` is
#: the number of counts per sample above which the encoder itself does not change the velocity by so much.
TIMING_HASTY = 0.42
TIMING_FINE = 3.0
#: Time in which the velocity of a machine changes by its size [s]. A longer or a shorter time is doubted if the
#: sample period is also beyond the periods of usual logs.
TIMING_SLOWEST = 1.0
TIMING_FASTEST = 1e-4
#: Counts per sample below which most samples carry no information. `TIMING_PLENTY` is a sufficient number of counts
#: per sample.
TIMING_IDLE = 0.02
TIMING_PLENTY = 0.2


def too_slow(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the velocity changes by much of its size within a sample period.

    The steps of a coarse sensor, which may be many counts, change the velocity as well, and say nothing.
    """
    change = np.diff(log.known.counts)
    moving = np.abs(change[change != 0])
    if moving.size < 2 or float(np.median(moving)) < TIMING_FINE:
        return
    if float(np.median(moving)) < TIMING_FINE * step_of(log.known.counts.astype(np.float64))[0]:
        return
    jumps = hasty(change)
    if not jumps > TIMING_HASTY:
        return
    yield Finding(
        "rate_low",
        f"the velocity changes by {100 * jumps:.0f} % of its size from row to row",
        f"make a new record at a sample period of at most {log.record.dt / 10 / min(jumps, 2):.1g} s",
        detail=f"With a sample period of {log.record.dt:g} s the record misses most of the motion.",
    )


def too_fast(log: CheckedLog) -> Iterator[Finding]:
    """Yield a finding if the count hardly ever changes within a sample period."""
    per_sample = counts_per_sample(log.known.counts)
    if 0 < per_sample < TIMING_IDLE:
        keep = max(2, round(TIMING_PLENTY / per_sample))
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
    slow = dt >= LONGEST_PLAIN_PERIOD and dt > TIMING_SLOWEST * hurry
    fast = dt < SHORTEST_PLAIN_PERIOD and dt < TIMING_FASTEST * hurry and per_row >= 1
    if not (hurry > 0 and (slow or fast)):
        return
    yield Finding(
        "odd_period",
        f"with a sample period of {dt:.6g} s and {per_row:.3g} counts per row, the velocity takes {dt / hurry:.3g} s "
        f"to change, which is unusually {'long' if slow else 'short'} for a machine",
        "dt is in s: give " + (f"{dt / 1e3:.6g} if {dt:.6g} ms was meant" if slow else "the time between two rows"),
    )
