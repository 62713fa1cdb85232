"""The part of a record without gaps that moves the most, for methods that need one motion without a break."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.session.records import Record

__all__ = ["unbroken"]


def unbroken(record: Record) -> Record:
    """The stretch of a record in which the input is known and the counts (n,) change most often, with a note; the
    record itself if it has no gaps."""
    known = np.isfinite(record.u)
    edges = np.flatnonzero(np.diff(np.r_[0, known, 0]))
    if np.all(known) or edges.size == 0:
        return record
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    first, last = max(
        pairs, key=lambda pair: (np.count_nonzero(np.diff(record.counts[slice(*pair)])), pair[1] - pair[0])
    )
    there = None if record.there is None else record.there[first:last]
    note = f"only the part without gaps that moves most is used here: {last - first} of {record.u.size} samples"
    notes = (*record.notes, note)
    return replace(record, u=record.u[first:last], counts=record.counts[first:last], there=there, notes=notes)
