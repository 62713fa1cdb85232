"""What AXIS.toml leaves open, chosen once for a whole fleet: by what the estimates of some of its axes are worth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.bridges import parts_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.fleet.series import UNUSABLE
from pmfid.fleet.settings import SEGMENTS, Chosen, forgetting_of, on_line, record_at, recursive
from pmfid.session.config import Axis
from pmfid.session.drives import make_estimator, of_kind
from pmfid.session.records import Record
from pmfid.session.tables import Table
from pmfid.status import Status

#: Time constants of the filters that are tried [samples].
TRIED = (10, 3, 30)
#: Records that are looked at, and segments of each.
RECORDS, MOST = 5, 4


def choose(axis: Axis, tables: Iterable[Table]) -> Chosen:
    """The pole, and the zeros to it, with which most segments of some records have an estimate, and of these the one
    with the least error bars; tables: of different axes.

    Raises UsageError for a method that is not recursive, and the first table's own error where none will do.
    """
    axis = on_line(axis)
    records, refused = _records(axis, tables)
    if not records:
        raise refused or UsageError("no axis has rows; check --axis and the columns of [record]")
    first = records[0]
    poles = [axis.estimator.cutoff] if axis.estimator.cutoff else [1 / (many * first.dt) for many in TRIED]
    found: list[tuple[tuple[int, float], Chosen]] = []
    for pole in poles:
        try:
            estimator = _estimator(axis, first, pole)
        except (UsageError, NotIdentifiableError) as error:
            refused = refused or error
            continue
        zeros = estimator.prefilter_zeros
        pair = None if zeros is None else (zeros[0], zeros[1])
        found.append((_worth(estimator, records), Chosen(pole, pair, first.dt, first.resolution)))
    if not found:
        raise refused or UsageError("no record of the fleet tells its filters; give [estimator] cutoff")
    return max(found, key=lambda pair: pair[0])[1]


def _records(axis: Axis, tables: Iterable[Table]) -> tuple[list[Record], UsageError | NotIdentifiableError | None]:
    """The liveliest parts of the first records that are some, at one sample period; and why others are none."""
    found, refused = list[Record](), None
    for table in tables:
        try:
            record = liveliest(record_at(table, axis))
        except (UsageError, NotIdentifiableError) as error:
            refused = refused or error
            continue
        if np.ptp(record.counts) > 0 and (not found or record.dt == found[0].dt):
            found.append(record)
        if len(found) == RECORDS:
            break
    return found, refused


def liveliest(record: Record) -> Record:
    """The part of a record that moves most, without a gap, of a few segments."""
    whole = max(parts_of(record.u), key=lambda part: part.stop - part.start, default=slice(0, 0))
    size = max(1, round(MOST * SEGMENTS[0] / record.dt))
    starts = range(whole.start, max(whole.start + 1, whole.stop - size + 1), size)
    parts = [slice(start, min(start + size, whole.stop)) for start in starts]
    travel = [int(np.abs(np.diff(record.counts[part])).sum()) for part in parts]
    part = parts[int(np.argmax(travel))]
    return replace(record, u=record.u[part], counts=record.counts[part], there=None)


def _estimator(axis: Axis, record: Record, pole: float) -> RecursiveEstimator:
    """With the memory that it will have, by which its zeros are chosen."""
    update = {"cutoff": pole, "forgetting": forgetting_of(SEGMENTS[0], record.dt)}
    own = axis.model_copy(update={"estimator": axis.estimator.model_copy(update=update)})
    return recursive(make_estimator(of_kind(record, own), record))


def _worth(estimator: RecursiveEstimator, records: Sequence[Record]) -> tuple[int, float]:
    """Estimates that can be used, of the quarters of all records, and minus the mean logarithm of their bars."""
    usable, bars = 0, list[float]()
    for record in records:
        quarter = max(1, record.u.size // MOST)
        tracks = estimator.start().side_by_side(1, workers=1).run(record.u[None], record.counts[None], quarter)
        status, std = tracks.status[0], tracks.theta_std[0]
        known = ((status & (UNUSABLE | int(Status.FALLBACK))) == 0) & np.all(np.isfinite(std) & (std > 0), axis=1)
        usable += int(np.count_nonzero(known))
        bars += np.log(std[known]).mean(axis=1).tolist()
    return usable, -float(np.mean(bars)) if bars else -math.inf
