"""One process of a stream, made to be killed: `python -m tests.spark.incarnation FOLDER SHARDS`.

FOLDER has `axis.toml` and its calibration, made by the caller. Blocks are in `in`, results in `out`, and the state in
`checkpoint`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from pmfid.fleet.shards import StreamPlan
from pmfid.pipeline.monitored import setup
from pmfid.stream.groups import Pace, prepare

#: Hours of simulated normal work: enough for thresholds on which no test relies.
HOURS = 0.5
PACE = Pace(window=0.6, every=0.1)
#: Settings of a session that starts fast.
QUICK = {"spark.driver.memory": "700m", "spark.default.parallelism": "2"}


def plan_of(folder: Path, shards: int) -> StreamPlan:
    """Return the plan of the stream in a folder."""
    setup.HOURS = HOURS
    os.environ["PMFID_CACHE"] = str(folder / "cache")
    return StreamPlan(prepare(folder / "axis.toml"), PACE, shards)


def main(folder: Path, shards: int) -> None:
    """Process all files, one file in a batch."""
    from pmfid.fleet.spark.stream import Pacing, stream_files

    pacing = Pacing(files=1, once=True)
    places = folder / "in", plan_of(folder, shards), folder / "checkpoint", folder / "out"
    stream_files(*places, pacing, master="local[2]", settings=QUICK)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
