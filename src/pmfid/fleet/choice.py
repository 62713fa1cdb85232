"""What AXIS.toml leaves open, chosen once for a whole fleet: by what the estimates of some of its axes are worth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.bridges import parts_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.fleet.series import UNUSABLE
from pmfid.fleet.settings import SEGMENTS, Chosen, choose_method, forgetting_of, record_at, recursive
from pmfid.session.config import Axis
from pmfid.session.drives import make_estimator, match_kind
from pmfid.session.records import Record
from pmfid.session.tables import Table
from pmfid.status import Status

#: Time constants of the filters that are tried [samples].
TRIED = (10, 3, 30)
#: Standard errors larger by this factor are an acceptable price of quicker filters.
CHEAP = 3.0
#: Records that are looked at, and segments of each.
RECORDS, MOST = 8, 5


def choose(axis: Axis, tables: Iterable[Table]) -> Chosen:
    """The pole, and its zeros, with which most segments of some records have an estimate, and of these the one with the
    smallest standard errors; tables: of different axes.

    Raises UsageError for a method that is not recursive, and the first table's own error if no pole fits.
    """
    axis = choose_method(axis)
    records, refused = _records(axis, tables)
    if not records:
        raise refused or UsageError("no axis has rows; check --axis and the columns of [record]")
    first = records[0]
    poles = [axis.estimator.cutoff] if axis.estimator.cutoff else [1 / (many * first.dt) for many in TRIED]
    found: list[tuple[tuple[int, float], Chosen]] = []
    for pole in poles:
        try:
            found += [(_worth(one, records), _make_choice(one)) for one in _estimators(axis, first, pole)]
        except (UsageError, NotIdentifiableError) as error:
            refused = refused or error
    if not found:
        raise refused or UsageError("no record of the fleet tells its filters; give [estimator] cutoff")
    return _best(found)


def _best(found: Sequence[tuple[tuple[int, float], Chosen]]) -> Chosen:
    """Of those with most segments the quickest filters that cost little: other axes may move more slowly than these,
    and leave less to slow ones."""
    most = max(usable for (usable, _), _ in found)
    known = [(stds, chosen) for (usable, stds), chosen in found if usable == most]
    least = max(stds for stds, _ in known)
    cheap = [(chosen.cutoff, stds, chosen) for stds, chosen in known if stds >= least - math.log(CHEAP) or not most]
    return max(cheap, key=lambda one: one[:2])[2]


def _records(axis: Axis, tables: Iterable[Table]) -> tuple[list[Record], UsageError | NotIdentifiableError | None]:
    """The liveliest parts of the first records that are some, at one sample period; and why others are none."""
    found = list[Record]()
    refused: UsageError | NotIdentifiableError | None = None
    for table in tables:
        try:
            record = liveliest(record_at(table, axis))
        except (UsageError, NotIdentifiableError) as error:
            refused = refused or error
            continue
        if np.ptp(record.counts) == 0:
            refused = refused or NotIdentifiableError("the first axes do not move: nothing tells their parameters")
        elif not found or record.dt == found[0].dt:
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


def _estimators(axis: Axis, record: Record, pole: float) -> Iterator[RecursiveEstimator]:
    """With all zeros of the pre-filters that there are to choose from, where they are not given."""
    update = {"cutoff": pole, "forgetting": forgetting_of(SEGMENTS[0], record.dt)}
    own = axis.model_copy(update={"estimator": axis.estimator.model_copy(update=update)})
    estimator = recursive(make_estimator(match_kind(record, own), record))
    if not estimator.instrumental or axis.estimator.prefilter_zeros is not None:
        yield estimator
        return
    needed = len(estimator.model.simple.equation.noisy)
    for zeros in estimator.plant.candidate_zeros(pole, estimator.memory, needed):
        yield replace(estimator, prefilter_zeros=zeros)


def _make_choice(estimator: RecursiveEstimator) -> Chosen:
    zeros = estimator.prefilter_zeros
    pair = None if zeros is None else (zeros[0], zeros[1])
    return Chosen(estimator.cutoff, pair, estimator.dt, estimator.encoder.resolution)


def _worth(estimator: RecursiveEstimator, records: Sequence[Record]) -> tuple[int, float]:
    """Number of usable segments of all records, and minus the mean logarithm of their standard errors."""
    size = min([round(SEGMENTS[0] / estimator.dt), *(record.u.size for record in records)])
    cuts = [(record, k) for record in records for k in range(0, record.u.size - size + 1, size)]
    u = np.stack([record.u[k : k + size] for record, k in cuts])
    counts = np.stack([record.counts[k : k + size] for record, k in cuts])
    tracks = estimator.start().side_by_side(len(cuts), workers=1).run(u, counts)
    status, std = tracks.status[:, -1], tracks.theta_std[:, -1]
    known = ((status & (UNUSABLE | int(Status.FALLBACK))) == 0) & np.all(np.isfinite(std) & (std > 0), axis=1)
    stds = np.log(std[known]).mean() if np.any(known) else math.inf
    return int(np.count_nonzero(known)), -float(stds)
