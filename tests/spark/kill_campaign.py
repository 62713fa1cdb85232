"""Kill a stream on Spark repeatedly, with the process group of its driver, at named points and at random:
`python -m tests.spark.kill_campaign --kills 20`.

After the last restart the states of all axes must have the bits of one process without Spark. The result files must
hold each estimate of that process once, and no others.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from pmfid.durable import CRASH_AT
from pmfid.fleet.shards import States, StreamPlan
from pmfid.fleet.spark.stream import SPARK, states_of
from studies.monitoring.pipe import write_axis
from tests.spark.incarnation import PACE, plan_of
from tests.spark.streams import Row, essence, estimates_of, in_one_process, parts_of, rows_of, write_parts

REPOSITORY = Path(__file__).parents[2]
SHARDS = 2
#: Crash points of the driver: the rows of a batch exist, a file is partly moved, half of the files are moved, all are
#: moved.
NAMED = ("stream.given", "stream.part", "stream.half", "stream.written")
#: Crash points seen from outside: Spark has noted the content of a batch, or its completion.
NOTED = ("offsets", "commits")
#: Longest time of a driver for the work of a campaign [s].
LONGEST = 900.0


@dataclass
class Campaign:
    """The number of kills, and the kills by crash point."""

    kills: int = 0
    at: Counter[str] = field(default_factory=Counter)


def started(folder: Path, setting: str) -> subprocess.Popen[bytes]:
    """Start a driver in its own process group."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1", CRASH_AT: setting}
    environment["JAVA_TOOL_OPTIONS"] = "-XX:TieredStopAtLevel=1 -XX:+UseSerialGC"
    command = [sys.executable, "-m", "tests.spark.incarnation", str(folder), str(SHARDS)]
    with open(folder / "said", "ab") as said:
        return subprocess.Popen(
            command, cwd=REPOSITORY, env=environment, start_new_session=True, stderr=said, stdout=said
        )


def kill_once(folder: Path, rng: random.Random) -> str | None:
    """Kill a driver and return the crash point; return None if the work was already complete.

    Raises AssertionError if the driver ended with an error.
    """
    point = rng.choice([*NAMED, *NOTED, "random", "random"])
    driver = started(folder, f"{point}:{rng.randint(1, 4)}" if point in NAMED else "")
    watched = point if point in NOTED else "offsets"
    before, more = _noted(folder, watched), rng.randint(1, 2)
    delay = rng.uniform(0.0, 2.5) if point == "random" else 0.0
    end = time.monotonic() + LONGEST
    while driver.poll() is None and time.monotonic() < end:
        if point not in NAMED and _noted(folder, watched) >= before + more:
            time.sleep(delay)
            break
        time.sleep(0.01)
    code = driver.poll()
    _kill(driver)
    assert code in (None, 0, -signal.SIGKILL), f"a driver ended with {code}: {(folder / 'said').read_text()[-2000:]}"
    return None if code == 0 else point


def _noted(folder: Path, kind: str) -> int:
    """Return the number of batches, including those whose notes Spark has removed."""
    place = folder / "checkpoint" / SPARK / kind
    numbers = [int(path.name) for path in place.iterdir() if path.name.isdigit()] if place.is_dir() else []
    return 1 + max(numbers, default=-1)


def _kill(driver: subprocess.Popen[bytes]) -> None:
    """Kill the whole process group: the driver and Java."""
    with suppress(ProcessLookupError):
        os.killpg(driver.pid, signal.SIGKILL)
    driver.wait()


def finish(folder: Path) -> None:
    """Let a last driver complete the work."""
    driver = started(folder, "")
    assert driver.wait(LONGEST) == 0, (folder / "said").read_text()[-2000:]
    _kill(driver)


def assert_same(folder: Path, plan: StreamPlan, rows: Sequence[Row]) -> tuple[int, int]:
    """Check that the stream ended as one process; return the numbers of compared axes and estimates."""
    bodies, table = in_one_process(plan, [rows])
    expected = States.from_bodies(bodies, plan.prepared.digest)
    states = states_of(folder / "checkpoint", plan.prepared.digest, "local[2]")
    assert states.axes == expected.axes
    for name in states.axes:
        one, other = (some.monitor(name, plan.prepared, PACE).get_state() for some in (states, expected))
        assert one == other, f"the state of {name} differs"
    pairs = zip(
        *(sorted(some.groups, key=lambda group: sorted(group.axes)) for some in (states, expected)), strict=True
    )
    for one, other in pairs:
        assert essence(one) == essence(other), "the order of the blocks differs"
    given = pl.read_parquet(folder / "out" / "estimates" / "*.parquet").sort("axis", "number")
    assert given.select("axis", "number").is_duplicated().sum() == 0, "an estimate is there twice"
    wanted = estimates_of(table).select(given.columns)
    assert given.height == wanted.height, f"{given.height} estimates, not {wanted.height}"
    assert given.equals(wanted, null_equal=True), "an estimate differs"
    assert not list((folder / "out").glob("*/*.part"))
    whole = {path.stem for path in (folder / "out" / "batches").iterdir()}
    assert whole == {path.stem for path in (folder / "out" / "estimates").iterdir()}
    return len(states.axes), given.height


def campaign(folder: Path, kills: int, axes: int, seconds: float, files: int, seed: int = 0) -> Campaign:
    """Kill the stream while files arrive; raise AssertionError if a kill changed the output."""
    write_axis(folder, 60.0)
    plan, rows, done, rng = plan_of(folder, SHARDS), rows_of(axes, seconds), Campaign(), random.Random(seed)
    write_parts(folder / "in", parts_of(rows, files))
    while done.kills < kills:
        point = kill_once(folder, rng)
        if point is None:
            break
        done.kills += 1
        done.at[point] += 1
        print(f"{done.kills} kills, the last at {point}; {_noted(folder, 'commits')} batches", flush=True)
    finish(folder)
    compared = assert_same(folder, plan, rows)
    print(f"{compared[0]} states and {compared[1]} estimates as in one process")
    return done


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the number of kills of each kind."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--axes", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--files", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        done = campaign(Path(name), given.kills, given.axes, given.seconds, given.files, given.seed)
    print(f"{done.kills} kills: {dict(sorted(done.at.items()))}")


if __name__ == "__main__":
    main()
