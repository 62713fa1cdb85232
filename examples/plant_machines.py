"""Simulate the twelve carts of examples/plant.toml and send their samples to an MQTT broker in real time. The mass of
one cart steps from 1.07 to 1.44 kg.

    python examples/plant_machines.py --step 60
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from pmfid.simulation import CART, CART_LOADED, Scenario, Schedule, change_parameters, make_scenario
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block

AXES, SAMPLES = 12, 25
LOADED = 7


def cart(number: int, seconds: float, step: float) -> Scenario:
    """Simulate a cart that moves between random places; the cart with number LOADED gets its load after `step` s."""
    loaded = change_parameters(CART, step, mass=CART_LOADED.mass)
    return make_scenario(
        "moves", seed=number + 1, duration=seconds, schedule=loaded if number == LOADED else Schedule(((0.0, CART),))
    )


def message(carts: list[Scenario], epoch: int, first: int) -> bytes:
    """Return SAMPLES samples of every cart, from number `first` on."""
    part = slice(first, first + SAMPLES)
    return b"".join(
        encode(
            Block(
                f"cart-{number:02d}",
                epoch,
                first,
                float(run.motion.t[first]),
                run.dt,
                run.motion.u[part],
                run.counts[part].astype(np.int64),
            )
        )
        for number, run in enumerate(carts)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=1883)
    parser.add_argument("--topic", default="hall-3/blocks")
    parser.add_argument("--seconds", type=float, default=600.0, help="how long they run [s]")
    parser.add_argument("--step", type=float, default=60.0, help=f"when the load of cart-{LOADED:02d} steps [s]")
    parser.add_argument("--speed", type=float, default=1.0, help="factor to run faster than real time")
    options = parser.parse_args()
    carts = [cart(number, options.seconds, options.step) for number in range(AXES)]
    client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
    client.connect(options.host, options.port)
    client.loop_start()
    begin, epoch, dt = time.monotonic(), int(time.time()), carts[0].dt
    print(f"{AXES} carts send to {options.topic}; the load of cart-{LOADED:02d} steps after {options.step:g} s")
    for first in range(0, carts[0].counts.size - SAMPLES + 1, SAMPLES):
        time.sleep(max(0.0, begin + (first + SAMPLES) * dt / options.speed - time.monotonic()))
        sent = client.publish(options.topic, message(carts, epoch, first), qos=1)
    sent.wait_for_publish(30)
    client.disconnect()


if __name__ == "__main__":
    main()
