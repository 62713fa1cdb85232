"""Simulate many machines that send blocks through a broker.

All axes run along the same long simulated record from different places, so that sending is cheap and every axis does
real work.

    python -m studies.service.machines --port 1883 --axes 10000 --seconds 600
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.simulation import make_scenario
from pmfid.simulation.scenarios import axis_toml, write_csv
from pmfid.stream.blocks import MAGIC, PLAIN, block_type

#: Sample period of the machines [s], and samples of a block.
DT, SAMPLES = 0.01, 50
#: Axes in a message, and number of parts of a block's time in which the axes send by turns.
AXES_IN_MESSAGE, TURNS = 50, 25
#: Samples between the places of neighbouring axes in the record.
APART = 37

NAME = "cell-{:06d}"
BLOCK = block_type(0, SAMPLES, len(NAME.format(0)))

AXIS = """
[monitor]
reference = "normal.csv"
mtbf_hours = 24.0
"""


def write_plant(folder: Path, axes: int, port: int, service: str = "") -> Path:
    """Write PLANT.toml, AXIS.toml and a record of normal work; `service` are further lines of [service]."""
    folder.mkdir(parents=True, exist_ok=True)
    normal = make_scenario("moves", seed=1, duration=600.0)
    write_csv(normal, folder / "normal.csv")
    (folder / "cell.toml").write_text(axis_toml(normal).replace("forgetting = 1.0", "forgetting = 0.995") + AXIS)
    plant = f"""\
[service]
name = "load"
{service}

[fleets.cells]
config = "cell.toml"
names = "cell-{{:06d}}"
count = {axes}

[sources.broker]
kind = "mqtt"
host = "127.0.0.1"
port = {port}
topics = ["load/blocks"]
"""
    path = folder / "plant.toml"
    path.write_text(plant)
    return path


class Machines:
    """Make the given number of axes with a record of `seconds`."""

    def __init__(self, axes: int, seconds: float) -> None:
        run = make_scenario("moves", seed=2, duration=seconds + axes * APART * DT)
        self.u, self.counts = run.motion.u.astype("<f4"), run.counts.astype("<i4")
        self.blocks = np.zeros(axes, BLOCK)
        self.blocks["magic"], self.blocks["version"], self.blocks["samples"] = MAGIC, PLAIN, SAMPLES
        self.blocks["name"] = [NAME.format(k).encode() for k in range(axes)]
        self.blocks["letters"], self.blocks["dt"] = len(NAME.format(0)), DT

    def messages(self, which: NDArray[np.int64], turn: int) -> list[bytes]:
        """Return block number `turn` of some axes, several in a message."""
        part = self.blocks[which]
        at = (which * APART + turn * SAMPLES)[:, None] + np.arange(SAMPLES)
        part["first"], part["time"] = turn * SAMPLES, turn * SAMPLES * DT
        part["u"], part["counts"] = self.u[at], self.counts[at]
        rows = part.view(np.uint8).reshape(part.size, BLOCK.itemsize)
        part["crc"] = [zlib.crc32(row) for row in rows[:, :-4]]
        return [part[k : k + AXES_IN_MESSAGE].tobytes() for k in range(0, part.size, AXES_IN_MESSAGE)]


def send(port: int, axes: int, seconds: float, topic: str = "load/blocks") -> dict[str, float]:
    """Send in real time at QoS 1; return the sent amounts, and the sender's own largest delay [s]."""
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    machines = Machines(axes, seconds)
    client = mqtt.Client(CallbackAPIVersion.VERSION2, "machines", protocol=mqtt.MQTTv5)
    client.max_inflight_messages_set(1000)
    client.connect("127.0.0.1", port)
    client.loop_start()
    groups = np.array_split(np.arange(axes), TURNS)
    sent, bytes_sent, late, begin = 0, 0, 0.0, time.monotonic()
    for turn in range(round(seconds / (SAMPLES * DT))):
        for k, which in enumerate(groups):
            due = begin + (turn + (k + 1) / TURNS) * SAMPLES * DT
            messages = machines.messages(which, turn)
            wait = due - time.monotonic()
            late = max(late, -wait)
            time.sleep(max(0.0, wait))
            for message in messages:
                bytes_sent += len(message)
                last = client.publish(topic, message, qos=1)
            sent += which.size
    last.wait_for_publish(30)
    client.disconnect()
    client.loop_stop()
    used = time.process_time()
    wall = time.monotonic() - begin
    return {"blocks": sent, "samples": sent * SAMPLES, "bytes": bytes_sent, "late": late, "cpu": used, "wall": wall}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=1883)
    parser.add_argument("--axes", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args()
    json.dump(send(options.port, options.axes, options.seconds), sys.stdout)


if __name__ == "__main__":
    main()
