"""What the estimates on the way through a segment say of that at its end: whether it has settled, and whether the
equation holds in all of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.track import Tracks
from pmfid.fleet.series import BACKWARD, FORWARD, ONE_SIZE
from pmfid.status import Status
from pmfid.types import Counts, Floats

#: Estimates of a segment that are kept.
MARKS = 16
#: Standard deviations by which those after the first quarter differ in any case.
USUAL = 3.0
#: Part of the second half in which the equation is off, from which on the segment is.
OFF = 0.25
#: Part of the travel that goes the other way, at least; mean over largest size of an input of several sizes, at most.
BACK, LEVEL = 0.05, 0.98


def settled_std(tracks: Tracks) -> Floats:
    """(n, p) standard deviations at the end, with what the estimate still moved by beyond chance: a start from a biased
    estimate, or a change within the segment, is forgotten no faster than the samples are."""
    std = tracks.theta_std[:, -1]
    moved = np.ptp(tracks.theta[:, _first_after(tracks, 4) :], axis=1)
    return np.asarray(np.hypot(std, np.maximum(moved - USUAL * std, 0.0)))


def lasting_status(tracks: Tracks) -> NDArray[np.uint32]:
    """(n,) at the end, and unmodelled where it was that for a part of the second half: the kernel's verdict is on the
    last motion alone."""
    off = (tracks.status[:, _first_after(tracks, 2) :] & Status.UNMODELLED) != 0
    wrong = np.mean(off, axis=1) >= OFF
    return np.asarray(tracks.status[:, -1] | np.where(wrong, Status.UNMODELLED, 0), np.uint32)


def evidence_gaps(u: Floats, counts: Counts) -> NDArray[np.uint32]:
    """(n,) status bits for effects that the inputs u and the counts (n, samples) cannot show."""
    there, travel = counts[:, -1] - counts[:, 0], np.abs(np.diff(counts, axis=1)).sum(axis=1)
    one_way = travel - np.abs(there) < 2 * BACK * travel
    way = np.where(one_way, np.where(there > 0, FORWARD, BACKWARD), 0)
    sizes = np.abs(u)
    one_size = sizes.mean(axis=1) > LEVEL * sizes.max(axis=1)
    return np.asarray(way | np.where(one_size, ONE_SIZE, 0), np.uint32)


def _first_after(tracks: Tracks, part: int) -> int:
    """Index of the first kept estimate after 1/part of the segment."""
    return (tracks.samples.size - 1) // part
