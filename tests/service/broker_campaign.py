"""Kill the broker repeatedly with the whole service connected to it, and at times the service itself:
`python -m tests.service.broker_campaign --kills 50 --service-kills 20`.

A gateway, Mosquitto and a service are processes of their own. The gateway sends three axes in real time at quality of
service 1. The broker is killed without notice and started again with its saved data. At the end every row of the
service and its last checkpoint must have the bits of a run without kills.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from examples.gateway import Gateway
from pmfid.service import arrangement
from pmfid.service.plant import Plant, ServiceSection
from pmfid.service.sources.mqtt import MqttSourceSection
from pmfid.service.web.config import PageConfig
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from pmfid.stream.groups import prepare
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, changing
from studies.monitoring.pipe import write_axis
from tests.service.broker import MISSING, Broker
from tests.service.kill_campaign import assert_same, died, incarnation, rows_of

#: Samples of a block, and seconds of data that the gateway keeps. The broker saves every second; the gateway sends the
#: kept data again after every new connection.
BLOCK, KEPT = 20, 2.5
#: Seconds after the last kill within which all data must arrive.
PATIENCE = 120.0
AXES = ("x1", "x2", "x3")


@dataclass(frozen=True)
class Work:
    """The motions of the axes in whole blocks; the second axis becomes heavier half-way."""

    motions: tuple[tuple[Floats, Counts], ...]

    @property
    def samples(self) -> int:
        """The number of samples of each axis."""
        return self.motions[0][0].size


def work_of(seed: int, seconds: float) -> Work:
    heavier = Schedule(((0.0, CART), (seconds / 2, replace(CART, mass=1.3 * CART.mass))))
    n = round(seconds / CART_DT) // BLOCK * BLOCK
    plants = [Schedule(((0.0, CART),)), heavier, Schedule(((0.0, CART),))]
    motions = [changing(plant, 7 * seed + k, INCREMENTS, seconds) for k, plant in enumerate(plants)]
    return Work(tuple((u[:n], counts[:n]) for u, counts in motions))


def plant_of(folder: Path, axis: Path, broker: Broker) -> Plant:
    service = ServiceSection(state="state", checkpoint=0.2, window=3 * BLOCK * CART_DT, every=0.0)
    source = MqttSourceSection(kind="mqtt", port=broker.port, topics=("hall/blocks",))
    return Plant(folder, service, dict.fromkeys(AXES, axis), {"hall": source}, page=PageConfig(enabled=False))


def gateway(work: Work, broker: Broker, speed: float) -> int:
    """Fork a child that sends all samples, and return its process number. The child sends `speed` times as fast as real
    time; 0 sends at once. The child exits with 0 when the broker has all samples."""
    number = os.fork()
    if number:
        return number
    code = 1
    try:
        sender = Gateway("hall/blocks", port=broker.port, keep=KEPT)
        begin = time.monotonic()
        for start in range(0, work.samples, BLOCK):
            due = begin + (start + BLOCK) * CART_DT / speed if speed else begin
            time.sleep(max(0.0, due - time.monotonic()))
            part = slice(start, start + BLOCK)
            blocks = (
                Block(name, 1, start, start * CART_DT, CART_DT, u[part], counts[part])
                for name, (u, counts) in zip(AXES, work.motions, strict=True)
            )
            sender.send(b"".join(map(encode, blocks)))
        sender.waiting.join()
        code = 0
    finally:
        os._exit(code)


@dataclass
class Running:
    """A plant that is served, and its broker; all incarnations print to `log`."""

    plant: Plant
    broker: Broker
    log: Path
    number: int = 0

    def serve(self) -> None:
        """Start the next incarnation of the service."""
        with self.log.open("a", encoding="utf-8") as log:
            self.number = incarnation(self.plant, "", log)

    def kill_service(self) -> None:
        os.kill(self.number, signal.SIGKILL)
        code = died(self.number, 10.0)
        assert code == -signal.SIGKILL, f"the service had ended with {code} before it was killed"

    def strike(self, what: str, rng: random.Random) -> None:
        """Kill the broker, the service, or the service while the broker is down."""
        if what == "service":
            self.kill_service()
            self.serve()
            return
        self.broker.kill()
        if what == "both":
            self.kill_service()
            self.serve()
        time.sleep(rng.choice([0.0, 0.2, 0.5]))
        self.broker.start()

    def finish(self, samples: int) -> None:
        """Wait for the output of every sample of every axis, then end the service."""
        end = time.monotonic() + PATIENCE
        while len(rows_of(self.plant)[0]) < samples * len(AXES) and time.monotonic() < end:
            time.sleep(0.5)
        os.kill(self.number, signal.SIGTERM)
        code = died(self.number, 60.0)
        assert code == 0, f"the service ended with {code}"


def strikes(kills: int, service_kills: int, rng: random.Random) -> list[str]:
    """Return the order of the kills; a third of the service's kills come while the broker is down."""
    both = min(kills, service_kills // 3)
    found = ["both"] * both + ["broker"] * (kills - both) + ["service"] * (service_kills - both)
    rng.shuffle(found)
    return found


def run(place: Path, axis: Path, work: Work, struck: Sequence[str], speed: float, rng: random.Random) -> Plant:
    """Do one run to its end, with the kills `struck` on the way."""
    place.mkdir()
    (place / "broker").mkdir()
    broker = Broker(place / "broker").start()
    running = Running(plant_of(place, axis, broker), broker, place / "log")
    (place / "rows").touch()
    running.serve()
    sending = gateway(work, broker, speed)
    pause = work.samples * CART_DT / max(speed, 1.0) / (len(struck) + 1)
    try:
        for k, what in enumerate(struck):
            time.sleep(pause * rng.uniform(0.5, 1.2))
            running.strike(what, rng)
            if (k + 1) % 10 == 0:
                print(f"{k + 1} of {len(struck)}: {what}", flush=True)
        code = died(sending, PATIENCE)
        assert code == 0, f"the gateway ended with {code}"
        running.finish(work.samples)
    finally:
        for number in (sending, running.number):
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(number, signal.SIGKILL)
                os.waitpid(number, 0)
        broker.stop()
    return running.plant


def campaign(
    axis: Path, folder: Path, kills: int, service_kills: int, apart: float, seed: int
) -> tuple[Counter[str], int]:
    """Compare a run with kills, `apart` seconds apart on average, to a run without kills. Returns the number of kills
    of each kind and the number of repeated rows. Raises AssertionError if a kill changed the output."""
    rng = random.Random(seed)
    struck = strikes(kills, service_kills, rng)
    work = work_of(seed, apart * (len(struck) + 1))
    prepared = prepare(axis)
    arrangement.prepare = lambda *given: prepared  # type: ignore[assignment]
    whole = run(folder / "whole", axis, work, (), 0.0, rng)
    assert len(rows_of(whole)[0]) == work.samples * len(AXES)
    killed = run(folder / "killed", axis, work, struck, 1.0, rng)
    return Counter(struck), assert_same(killed, whole)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the number of kills of each kind; fail if a kill changed the output."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=50, help="of the broker")
    parser.add_argument("--service-kills", type=int, default=0, help="of the service, in between")
    parser.add_argument("--apart", type=float, default=2.5, help="seconds between two of them, on average")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    if MISSING:
        sys.exit(MISSING)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_axis(folder, 60.0)
        struck, again = campaign(
            folder / "axis.toml", folder, given.kills, given.service_kills, given.apart, given.seed
        )
    of_broker, of_service = struck["broker"] + struck["both"], struck["service"] + struck["both"]
    print(f"{of_broker} kills of the broker, {of_service} of the service ({struck['both']} while the broker was away)")
    print(f"every state and row as without kills; {again} rows came again")


if __name__ == "__main__":
    main()
