"""Many carts on a broker: sent samples, the page, the metrics, and the expected estimates."""

from __future__ import annotations

import base64
import json
import math
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
from numpy.typing import NDArray
from paho.mqtt.enums import CallbackAPIVersion

from pmfid.monitor.fleet import MonitorFleet
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import make_scenario
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from pmfid.stream.groups import prepare
from pmfid.types import Floats
from studies.service.machines import DT, NAME, write_plant
from studies.service.processes import BROKER, Service, broker, free_port, service

#: Samples of a block, and samples between the places of neighbouring axes in the motion.
SAMPLES, APART = 25, 37
PAGE = '\n[page]\nport = {port}\ntoken = "env:PMFID_TOKEN"\n'
#: Longest time for the processing of all sent samples [s].
PATIENCE = 60.0

#: Function that returns the bytes to send in place of a block; none means that the block is lost.
Change = Callable[[Block], Sequence[bytes]]
Metrics = dict[str, float]
Report = dict[str, Any]


def name_of(k: int) -> str:
    """Return the name of axis k."""
    return NAME.format(k)


@dataclass
class Hall:
    """A hall of machines.

    `served` is the service, and `client` sends the samples. All axes run along the motion u, counts; `axes` is their
    number. `at` counts the sent samples of each axis, and `sent` those of all. `struck` holds the numbers of changed
    axes.
    """

    folder: Path
    served: Service
    client: mqtt.Client
    u: Floats
    counts: NDArray[np.int64]
    axes: int
    at: int = field(default=0, init=False)
    sent: int = field(default=0, init=False)
    struck: set[int] = field(default_factory=set, init=False)
    _seen: set[int] = field(default_factory=set, init=False)

    # --- sending ------------------------------------------------------------------------------------------------------

    def play(self, seconds: float, speed: float = 5.0, changes: dict[int, Change] | None = None) -> None:
        """Play some seconds of the motion of all axes, `speed` times as fast as real time. `changes` replaces the
        blocks of some axes."""
        changes, begin, start = changes or {}, time.monotonic(), self.at
        self.struck |= changes.keys()
        while self.at < start + seconds / DT:
            for k in range(self.axes):
                block = self.block(k, self.at)
                for data in changes.get(k, _as_it_is)(block):
                    self.publish(data)
            self.at += SAMPLES
            self.sent += self.axes * SAMPLES
            time.sleep(max(0.0, begin + (self.at - start) * DT / speed - time.monotonic()))
        self.last.wait_for_publish(PATIENCE)

    def block(self, k: int, start: int) -> Block:
        place = k * APART + start
        part = slice(place, place + SAMPLES)
        return Block(name_of(k), 1, start, 1e9 + start * DT, DT, self.u[part], self.counts[part])

    def publish(self, data: bytes) -> None:
        self.last = self.client.publish("load/blocks", data, qos=1)

    # --- reports ------------------------------------------------------------------------------------------------------

    def through(self, more: int = 0) -> Metrics:
        """Return the metrics when all sent samples, except `more`, are taken, missing or dropped."""
        end = time.monotonic() + PATIENCE
        while True:
            metrics = self.served.metrics()
            if self.accounted(metrics) >= self.sent - more or time.monotonic() > end:
                return metrics
            time.sleep(0.5)

    def accounted(self, metrics: Metrics) -> float:
        """Return the number of samples that became estimates or are reported as missing."""
        return self.total("pmfid_samples_total", metrics) + self.total("pmfid_samples_missing_total", metrics)

    def total(self, name: str, metrics: Metrics | None = None) -> float:
        return self.served.total(name, metrics)

    def notices(self) -> list[Report]:
        """Return the new notices of the page."""
        news = json.loads(self.served.get("/api/news"))
        fresh = [one for one in news["notices"] if one["number"] not in self._seen]
        self._seen |= {one["number"] for one in fresh}
        return fresh

    def post(self, path: str) -> None:
        """Send a write action to the page."""
        headers = {"Authorization": f"Bearer {self.served.token}", "Content-Type": "application/json"}
        address = f"http://127.0.0.1:{self.served.port}{path}"
        urllib.request.urlopen(urllib.request.Request(address, b"{}", headers), timeout=30).close()

    def rows(self, axis: str) -> tuple[NDArray[np.int64], Floats]:
        """Return the page's numbers (m,) and theta (m, p) of an axis."""
        history = json.loads(self.served.get(f"/api/news?axis={axis}"))["rows"]
        theta = np.column_stack([_unpacked(column) for column in history["theta"]])
        return _unpacked(history["number"]).astype(np.int64), theta

    # --- expected estimates -------------------------------------------------------------------------------------------

    def compared(self, since: int = 0, axes: Sequence[int] | None = None) -> tuple[int, int]:
        """Count the rows of the page after sample `since`, and those with another bit than `pmfid monitor`. `axes` are
        the numbers of the compared axes; None means all unchanged axes."""
        others = [k for k in range(self.axes) if k not in self.struck] if axes is None else list(axes)
        monitor = prepare(self.folder / "cell.toml").setup.monitor
        assert isinstance(monitor, Monitor)
        fleet = MonitorFleet(monitor, len(others))
        places = np.array(others)[:, None] * APART + np.arange(self.at)
        expected = fleet.run(np.arange(len(others)), self.u[places], self.counts[places]).theta
        found = differ = 0
        for row, k in enumerate(others):
            numbers, theta = self.rows(name_of(k))
            theta, numbers = theta[numbers > since], numbers[numbers > since]
            found += numbers.size
            wanted = expected[row, numbers - 1]
            differ += int(np.any(theta.view(np.int64) != wanted.view(np.int64), axis=1).sum())
        return found, differ


def _as_it_is(block: Block) -> list[bytes]:
    return [encode(block)]


def _unpacked(text: str) -> Floats:
    kind, _, data = text.partition(":")
    return np.frombuffer(base64.b64decode(data), f"<{kind}").astype(np.float64)


def lost(block: Block, part: slice) -> Block:
    """Return the block with lost inputs for some samples."""
    u = block.u.copy()
    u[part] = math.nan
    return replace(block, u=u)


@contextmanager
def hall(
    place: Path,
    axes: int,
    seconds: float,
    more: str = "",
    settings: str = 'state = "state"\nevery = 0.1',
    limits: str = BROKER,
    ready: Callable[[Path], object] = lambda place: None,
) -> Iterator[Hall]:
    """Run a hall in its own folder, whose machines have `seconds` of motion.

    `more` are further sections of PLANT.toml, and `settings` are lines of [service]. `limits` configures the broker,
    and `ready` is called once the files exist.
    """
    run = make_scenario("moves", seed=2, duration=seconds + axes * APART * DT + 1.0)
    place.mkdir(parents=True, exist_ok=True)
    with broker(place, limits) as (port, _):
        plant = write_plant(place, axes, port, settings)
        plant.write_text(plant.read_text() + more + PAGE.format(port=free_port()))
        ready(place)
        with service(plant, place / "log.jsonl") as served:
            client = mqtt.Client(CallbackAPIVersion.VERSION2, "machines", protocol=mqtt.MQTTv5)
            client.max_inflight_messages_set(1000)
            client.connect("127.0.0.1", port, keepalive=600)
            client.loop_start()
            while not served.total("pmfid_axes") or served.total("pmfid_axes_calibrating"):
                time.sleep(0.1)
            time.sleep(1.0)  # time for the source's subscription
            yield Hall(place, served, client, run.motion.u, run.counts.astype(np.int64), axes)
            client.disconnect()
            client.loop_stop()
