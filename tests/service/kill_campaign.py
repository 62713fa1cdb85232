"""Kill the service repeatedly, at named points and at random: `python -m tests.service.kill_campaign --kills 1000`.

Each incarnation is a process of its own, forked from a process that has calibrated. The first source has blocks of one
axis and lines of another, the second has whole blocks of a third axis. Both deliver again until they have an
acknowledgement, as a broker does at QoS 1. After some kills the last incarnation runs to the end. The final
state and all rows must have the bits of a run without kills.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import signal
import sqlite3
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Condition
from typing import IO, Literal

from pmfid.durable import arm
from pmfid.service import arrangement
from pmfid.service.context import Context, Source, SourceSection, Take
from pmfid.service.plant import Plant, ServiceSection
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog
from pmfid.service.web.config import PageConfig
from pmfid.simulation import CART_DT
from pmfid.stream.checkpoint import Saved, Snapshot, read_snapshot
from pmfid.stream.delivery import Block, Delivery, Item, Lines
from pmfid.stream.groups import prepare
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.store import FILE, Vault
from pmfid.stream.timeline import Line
from pmfid.stream.tuning import TUNING
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import write_axis
from tests.edge_axes import cart_edges, heavier, write_edge_axis
from tests.service.orders import made

#: All crash points, in the order in which a block passes them.
POINTS = (
    *("inbox.taken", "engine.ordered", "engine.stepped", "engine.reported", "checkpoint.made", "checkpoint.half"),
    *("checkpoint.written", "checkpoint.durable", "ack", "acked"),
)
WINDOW = 60
#: Most messages without an acknowledgement, as in a broker.
UNDER_WAY = 30


@dataclass(frozen=True)
class Work:
    """The items to deliver: blocks of x1 out of order and lines of x3, and blocks of x2."""

    hall: tuple[Item, ...]
    cell: tuple[Item, ...]


def work_of(seed: int, seconds: float) -> Work:
    """Return the motions of three axes."""
    motions = [changing(heavier(seconds / 2), 5 * seed + k, INCREMENTS, seconds) for k in range(3)]
    blocks = [replace(b, axis="x1", dt=CART_DT) for b in made(*motions[0], random.Random(seed), WINDOW).arrived]
    lines = [Line(k * CART_DT, float(a), int(b)) for k, (a, b) in enumerate(zip(*motions[2], strict=True)) if k != 333]
    return Work(_mix(blocks, lines), _whole(*motions[1]))


def edge_work_of(seed: int, seconds: float) -> Work:
    """Return the work of axes with the ages of edges."""
    motions = [cart_edges(heavier(seconds / 2), 5 * seed + k, seconds) for k in range(3)]
    u, counts, ages = motions[0]
    sending = made(u, counts, random.Random(seed), WINDOW, ages=ages)
    rows = enumerate(zip(*(part.tolist() for part in motions[2]), strict=True))
    lines = [Line(k * CART_DT, a, b, further=age) for k, (a, b, age) in rows if k != 333]
    return Work(_mix([replace(b, axis="x1", dt=CART_DT) for b in sending.arrived], lines), _whole(*motions[1]))


def _whole(u: Floats, counts: Counts, ages: Floats | None = None) -> tuple[Block, ...]:
    """Return the blocks of x2, in order."""
    found = list[Block]()
    for k in range(0, u.size, 5):
        own = None if ages is None else ages[k : k + 5]
        found.append(Block("x2", 0, k, math.nan, CART_DT, u[k : k + 5], counts[k : k + 5], own))
    return tuple(found)


def _mix(blocks: Sequence[Block], lines: Sequence[Line]) -> tuple[Item, ...]:
    some = [Lines("x3", lines[k : k + 20]) for k in range(0, len(lines), 20)]
    share = max(1, len(blocks) // len(some))
    items: list[Item] = []
    for k, own in enumerate(some):
        items += [own, *blocks[k * share : (k + 1) * share]]
    return (*items, *blocks[len(some) * share :])


class Broker(SourceSection):
    """A broker that delivers again until it has an acknowledgement."""

    kind: Literal["broker"] = "broker"
    folder: str
    seed: int
    seconds: float

    def make(self, name: str, context: Context) -> Source:
        return _Client(name, Path(self.folder), getattr(WORK[self.seed, self.seconds], name))


#: Work by seed and length, made before the fork.
WORK: dict[tuple[int, float], Work] = {}


@dataclass
class _Client:
    name: str
    folder: Path
    items: tuple[Item, ...]
    _under_way: int = field(default=0, init=False)
    _stopped: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._changed = Condition()
        self._file = os.open(self._place, os.O_RDWR | os.O_CREAT | os.O_APPEND)

    @property
    def _place(self) -> Path:
        return self.folder / f"acknowledged-{self.name}"

    def run(self, take: Take) -> None:
        known = {int(line) for line in self._place.read_text().split()}
        for k, item in enumerate(self.items):
            if k in known:
                continue
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or self._under_way < UNDER_WAY)
                self._under_way += 1
            if self._stopped or not take(Delivery(self.name, [item], lambda k=k: self._acknowledge(k))):
                return

    def _acknowledge(self, k: int) -> None:
        os.write(self._file, f"{k}\n".encode())
        with self._changed:
            self._under_way -= 1
            self._changed.notify()

    def stop(self) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify()


_ROW = struct.Struct("<BqddddddBq")


@dataclass
class _RowFile:
    """A file of rows; each row is in the file when the call returns."""

    path: Path

    def __post_init__(self) -> None:
        self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def rows(self, rows: EstimateRows) -> None:
        numbers = [int(name[1:]) for name in rows.group.axes]
        packed = [
            _ROW.pack(
                numbers[rows.axis[k]],
                int(rows.number[k]),
                *rows.theta[k].tolist(),
                *rows.std[k][:2].tolist(),
                float(rows.innovation[k]),
                int(rows.state[k]),
                int(rows.status[k]),
            )
            for k in range(rows.axis.size)
        ]
        os.write(self._file, b"".join(packed))

    def notice(self, notice: Notice) -> None:
        """Ignore notices."""


class _Service(Service):
    """A service with an outlet that is never late. All sources wait for all axes, also at the first start, because
    data of an axis without a calibration are dropped.
    """

    def _prepare(self, plant: Plant) -> None:
        super()._prepare(plant)
        self._needed, self._engine.waiting = set(self._configs), True
        self._outlets.append(_RowFile(plant.folder / "rows"))


def plant_of(folder: Path, axis: Path, seed: int, seconds: float) -> Plant:
    service = ServiceSection(state="state", checkpoint=0.05, window=WINDOW * CART_DT, every=0.0)
    broker = Broker(folder=str(folder), seed=seed, seconds=seconds)
    sources: dict[str, SourceSection] = {"hall": broker, "cell": broker}
    return Plant(folder, service, dict.fromkeys(("x1", "x2", "x3"), axis), sources, page=PageConfig(enabled=False))


def incarnation(plant: Plant, setting: str, log: IO[str]) -> int:
    """Fork a child that serves the plant until the plant or its sources end; return the child's process number."""
    number = os.fork()
    if number:
        return number
    code = 1
    try:
        arm(setting)
        _Service(lambda: plant, NoticeLog(log), until_end=True).run()
        code = 0
    finally:
        os._exit(code)


def died(number: int, within: float) -> int | None:
    """Return the exit status of a child, or None for a child that still lives after `within` seconds."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        found, status = os.waitpid(number, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    return None


@dataclass
class Round:
    """The counts of a round: kills, kills by crash point, and incarnations that ended by themselves."""

    kills: int = 0
    ended: int = 0
    at: Counter[str] = field(default_factory=Counter)


def kill_round(plant: Plant, wanted: int, rng: random.Random, log: IO[str], longest: float) -> Round:
    """Kill until the wanted number of kills or the end of the work; raise AssertionError if an incarnation fails to
    start.
    """
    done = Round()
    while done.kills < wanted:
        point = rng.choice([*POINTS, "random", "random", "random"])
        setting = "" if point == "random" else f"{point}:{rng.randint(1, 4)}"
        number = incarnation(plant, setting, log)
        code = died(number, rng.uniform(0.02, longest) if point == "random" else longest)
        if code is None:
            os.kill(number, signal.SIGKILL)
            _, status = os.waitpid(number, 0)
            code, point = os.waitstatus_to_exitcode(status), "random"
        assert code in (0, -signal.SIGKILL), f"an incarnation ended with {code}"
        if code == 0:
            done.ended += 1
            break
        done.kills += 1
        done.at[point] += 1
    return done


def finish(plant: Plant, log: IO[str]) -> None:
    """Run the last incarnation to its end."""
    number = incarnation(plant, "", log)
    code = died(number, 120.0)
    if code is None:
        os.kill(number, signal.SIGKILL)
    assert code == 0, f"the last incarnation ended with {code}"


def state_of(plant: Plant) -> Snapshot:
    """Return the last checkpoint."""
    assert plant.state is not None
    vault = Vault(plant.state)
    damaged = list[dict[str, object]]()
    found = vault.load(read_snapshot, damaged.append)
    vault.close()
    assert found is not None
    assert not damaged
    return found


def rows_of(plant: Plant) -> tuple[dict[tuple[int, int], bytes], int]:
    """Return the bits of all rows by (axis, number), and the number of repeated rows. Raises AssertionError if a row
    was repeated with other bits."""
    data, found, again = (plant.folder / "rows").read_bytes(), dict[tuple[int, int], bytes](), 0
    for k in range(0, len(data) - _ROW.size + 1, _ROW.size):
        row = data[k : k + _ROW.size]
        axis, number = _ROW.unpack(row)[:2]
        again += (axis, number) in found
        assert found.setdefault((axis, number), row) == row, f"axis {axis}: sample {number} came out otherwise"
    return found, again


def notices_of(plant: Plant) -> list[tuple[object, ...]]:
    """Return the notices on data in the history of a service."""
    assert plant.state is not None
    query = f"SELECT axis, number, event, what FROM notices WHERE number < {TUNING.notices_own} ORDER BY axis, number"
    with closing(sqlite3.connect(plant.state / FILE)) as database:
        return database.execute(query).fetchall()


def _kept(saved: Saved) -> dict[str, object]:
    """Return the states that only some axes have, without the counts of late and repeated deliveries."""
    return {name: {**rare, "told": {**rare.get("told", {}), "late": 0}} for name, rare in saved.rare.items()}


def assert_same(killed: Plant, whole: Plant) -> int:
    """Check that a killed plant ended as a plant without kills; return the number of repeated rows."""
    (rows, again), (expected, _) = rows_of(killed), rows_of(whole)
    differ = sorted(key for key in rows.keys() | expected.keys() if rows.get(key) != expected.get(key))
    missing, more = len(expected.keys() - rows.keys()), len(rows.keys() - expected.keys())
    assert not differ, (
        f"{len(differ)} rows differ (axis, number), from {differ[0]} to {differ[-1]}: {missing} are missing, {more} "
        f"should not be; {state_of(killed).alarms}"
    )
    a, b = state_of(killed), state_of(whole)
    for one, other in zip(a.groups, b.groups, strict=True):
        assert one.axes == other.axes
        assert _kept(one) == _kept(other)
        assert one.state == other.state, "the states of the monitors differ"
        assert one.seats == other.seats, "the order of the blocks differs"
        assert one.held == other.held
    written, whole_written = notices_of(killed), notices_of(whole)
    assert written == whole_written, "a notice is missing, or is there twice"
    assert not list((killed.folder / "state").glob("*damaged*"))
    return again


def campaign(
    axis: Path, folder: Path, kills: int, a_round: int, seconds: float, seed: int = 0, edges: bool = False
) -> Round:
    """Compare runs with kills, in rounds of `a_round` kills with separate data, to a run without kills."""
    total, rng = Round(), random.Random(seed)
    prepared = prepare(axis)
    arrangement.prepare = lambda *given: prepared  # type: ignore[assignment]
    with open(os.devnull, "w", encoding="utf-8") as log:
        while total.kills < kills:
            seed += 1
            pair = []
            for name in ("killed", "whole"):
                place = folder / f"{name}-{seed}"
                place.mkdir()
                WORK[seed, seconds] = (edge_work_of if edges else work_of)(seed, seconds)
                pair.append(plant_of(place, axis, seed, seconds))
            done = kill_round(pair[0], min(a_round, kills - total.kills), rng, log, 0.6)
            finish(pair[0], log)
            finish(pair[1], log)
            again = assert_same(*pair)
            total.kills += done.kills
            total.ended += done.ended
            total.at.update(done.at)
            if done.kills:
                print(f"{total.kills} kills, {again} rows came again", flush=True)
    return total


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the number of kills of each kind; fail if a kill changed the output."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--round", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--edges", action="store_true", help="axes with the ages of edges")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name, suppress(KeyboardInterrupt):
        folder = Path(name)
        (write_edge_axis if given.edges else write_axis)(folder, 60.0)
        axis = folder / "axis.toml"
        total = campaign(axis, folder, given.kills, given.round, given.seconds, given.seed, given.edges)
    print(f"{total.kills} kills, {total.ended} rounds whose data ended before: every state and row as without kills")
    for point, times in sorted(total.at.items()):
        print(f"{times:6d}  {point}")


if __name__ == "__main__":
    sys.exit(main())
