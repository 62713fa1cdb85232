"""Watch an axis whose friction follows the temperature of each day, and that loses or gains preload:
`python -m studies.monitoring.warm_axis --hours 300`.

The axis works for a minute in ten. Its friction varies by 15 % up and down each day.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from pmfid import IV, RIV, Drive, Encoder
from pmfid.estimators.configuration import like
from pmfid.monitor import Alarm, Monitor, Watch, calibrate
from pmfid.monitor.warmth import find_warmth
from pmfid.simulation import CART, quantize, resolution_of, simulate_drive
from pmfid.types import Counts, Floats

DT, RESOLUTION = 0.01, resolution_of(1024)
DRY = replace(CART, coulomb_friction=2.5)
#: Friction over temperature, relative per K, and half of the range of a day [K].
RATE, SWING = -0.015, 10.0
#: Samples in a stretch of work, and from one to the next.
WORK, EVERY = 6000, 60_000
Columns = tuple[Floats, Counts, Floats]


def temperature(hour: float, day: float = 24.0) -> float:
    return 30 + SWING * float(np.sin(2 * np.pi * hour / day))


def stretches(
    seed: int,
    count: int,
    every: float,
    warm: Callable[[float], float] = temperature,
    loss: float = 0.0,
    samples: int = WORK,
) -> Iterator[Columns]:
    """Yield input, counts and temperature of stretches of work, one `every` hours, with a `loss` of friction per hour.

    A stretch continues the motion of the preceding one.
    """
    rng, x, v = np.random.default_rng(seed), 0.0, 0.0
    for k in range(count):
        hot, left = warm(k * every), 1 - loss * k * every
        drive = replace(DRY, coulomb_friction=DRY.coulomb_friction * (1 + RATE * (hot - 30)) * left)
        u = np.repeat(rng.uniform(-6, 6, samples // 20), 20)
        motion = simulate_drive(drive, np.append(u, 0.0), DT, x, v)
        yield u, quantize(motion.x[:-1], RESOLUTION), np.full(samples, hot)
        x, v = float(motion.x[-1]), float(motion.v[-1])


def record(seed: int, minutes: float, day: float, loss: float = 0.0) -> Columns:
    """Return input, counts and temperature of continuous work, whose day has `day` hours."""
    samples = 500  # the temperature of a machine hardly changes in 5 s
    every = samples * DT / 3600
    parts = stretches(seed, round(minutes / 60 / every), every, lambda hour: temperature(hour, day), loss, samples)
    u, counts, hot = map(np.concatenate, zip(*parts, strict=True))
    return u, counts, hot


def make_monitor(seed: int, watch: Watch, minutes: float = 40.0) -> Monitor:
    """Return a monitor that learned from minutes of work during warm-ups and coolings."""
    u, counts, hot = record(seed, minutes, minutes / 80)
    riv = RIV(Drive(CART.input_gain), Encoder(RESOLUTION), DT, 50.0, forgetting=0.998)
    front = like(IV, riv, prefilter_zeros=None)
    _, theta = find_warmth(front, front.fit(u, counts).theta, u, counts, hot)
    riv = replace(riv, initial=dict(zip(riv.names, theta.tolist(), strict=True)))
    return Monitor(riv, calibrate(riv, theta, u, counts, hot), watch)


def run(monitor: Monitor, seed: int, hours: float, loss: float, sensed: bool = True) -> Iterator[tuple[float, Alarm]]:
    """Yield the hours of the alarms, and the alarms. Without `sensed` the monitor gets no temperature."""
    every = EVERY * DT / 3600
    for k, (u, counts, hot) in enumerate(stretches(seed, round(hours / every), every, temperature, loss)):
        rows = monitor.run(u, counts, hot if sensed else None)
        yield from ((k * every, event) for *_, event in rows.events if isinstance(event, Alarm))
        monitor.skip(EVERY - WORK)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=300.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--tolerance", type=float, default=0.005)
    parser.add_argument("--mtbf", type=float, default=24.0)
    options = parser.parse_args()
    watch = Watch(options.mtbf, options.tolerance)
    worked = options.hours * WORK / EVERY
    for seed in range(options.seeds):
        monitor = make_monitor(seed, watch)
        still = list(run(monitor.fresh(), 100 + seed, options.hours, 0.0))
        blind = list(run(monitor.fresh(), 100 + seed, min(48.0, options.hours), 0.0, sensed=False))
        print(
            f"seed {seed}: {len(still)} alarms in {worked:.3g} h of work, {worked / options.mtbf:.2g} asked; without "
            f"the temperature {len(blind)} in {0.1 * min(48.0, options.hours):.3g} h"
        )
        for loss in (0.1, -0.1):
            hour, alarm = next(run(monitor.fresh(), 200 + seed, options.hours, loss / 300), (float("nan"), None))
            named = "nothing" if alarm is None else f"{alarm.parameter} {100 * alarm.relative:+.2f} %"
            print(f"seed {seed}: friction {-100 * loss:+.0f} % in 300 h: {named} after {hour:.1f} h", flush=True)


if __name__ == "__main__":
    main()
