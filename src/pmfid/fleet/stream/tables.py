"""What a batch of a shard gave as a table: a row for each estimate, each notice, and the counts."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from pmfid.monitor.events import STATES
from pmfid.stream.notices import OF_AXIS, OWN

if TYPE_CHECKING:
    import polars as pl

    from pmfid.fleet.stream.shard import StreamPlan, StreamShard
    from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["COUNTS", "ESTIMATE", "NOTICE", "columns_of", "table_of"]

#: What a row is, in the column `row`.
ESTIMATE, NOTICE, COUNTS = "estimate", "notice", "counts"


def columns_of(plan: StreamPlan) -> dict[str, str]:
    """Name -> type of Spark of each column. number: samples of the axis so far, of a notice its number of that axis,
    0 if it does not concern data; told: JSON, for a notice the line that `pmfid monitor --json` prints."""
    names = plan.prepared.setup.monitor.names
    return {
        **{"row": "string", "axis": "string", "number": "long", "time": "double", "u": "double", "counts": "long"},
        **{column: "double" for name in names for column in (name, f"{name}_std")},
        **{"innovation": "double", "status": "long", "state": "string", "told": "string"},
    }


def table_of(shard: StreamShard) -> pl.DataFrame:
    """All that a batch of a shard gave, with these columns."""
    import polars as pl

    types = {"string": pl.String, "long": pl.Int64, "double": pl.Float64}
    schema = {name: types[kind] for name, kind in columns_of(shard.plan).items()}
    frames = [_estimates(rows) for rows in shard.outcomes.estimates]
    frames += [_notice(one) for one in shard.outcomes.notices]
    frames.append(pl.DataFrame({"row": [COUNTS], "axis": [""], "told": [json.dumps(shard.count_samples())]}))
    found = pl.concat([pl.DataFrame(schema=schema), *frames], how="diagonal")
    return found.with_columns(pl.col("number", "counts", "status").fill_null(0))


def _estimates(rows: EstimateRows) -> pl.DataFrame:
    import polars as pl

    axes, states = np.array(rows.group.axes, object), np.array(STATES, object)
    own = {
        "row": [ESTIMATE] * rows.axis.size,
        "axis": axes[rows.axis].tolist(),
        "number": rows.number,
        "time": rows.time,
        "u": rows.u,
        "counts": rows.counts,
    }
    for k, name in enumerate(rows.group.names):
        own[name], own[f"{name}_std"] = rows.theta[:, k], rows.std[:, k]
    rest = {"status": rows.status.astype(np.int64), "state": states[rows.state].tolist()}
    return pl.DataFrame({**own, "innovation": rows.innovation, **rest})


def _notice(notice: Notice) -> pl.DataFrame:
    import polars as pl

    number = 0 if notice.number >= OWN else notice.number % OF_AXIS
    columns = {"row": [NOTICE], "axis": [notice.axis], "number": [number], "told": [json.dumps(notice.what)]}
    time = notice.what.get("time")
    return pl.DataFrame({**columns, "time": pl.Series([time], dtype=pl.Float64)})
