"""The reference record of an axis, as the page compares with it."""

from __future__ import annotations

import io

import numpy as np

from pmfid.session.records import Record

__all__ = ["csv_of"]

#: Rows that are shown at most.
ROWS = 50_000


def csv_of(record: Record) -> bytes:
    """Columns t [s] from 0, u and counts; of a long record its beginning, for a comparison needs every sample."""
    n = min(record.u.size, ROWS)
    table = np.column_stack([record.dt * np.arange(n), record.u[:n], record.counts[:n]])
    text = io.StringIO()
    np.savetxt(text, table, fmt=["%.9g", "%.9g", "%d"], delimiter=",", header="t,u,counts", comments="")
    return text.getvalue().encode("ascii")
