"""An engine that estimates nothing: it makes realistic rows and alarms for tests of the page.

`python -m tests.service.fake_engine --axes 12 --port 8127` serves the page with them.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Thread

import numpy as np

from pmfid.monitor.events import STATES, Alarm, Change
from pmfid.pipeline.monitored.run import event_object
from pmfid.records.record import Record
from pmfid.service.web.board import Board
from pmfid.service.web.config import PageConfig
from pmfid.service.web.server import serve
from pmfid.status import Status
from pmfid.stream.outcome import Counters, EstimateRows, Kindred, Notice

DT = 0.01
WATCHING, CANNOT_TELL, SUSPICIOUS, STARTING = (
    STATES.index(name) for name in ("watching", "cannot tell", "suspicious", "starting")
)
NAMES = (
    ("gantry-x1", "gantry-x2", "gantry-y", "gantry-z", "feeder-1", "feeder-2"),
    ("spindle-a", "spindle-b", "turntable", "gripper", "lift-1", "lift-2"),
)


def kindreds(axes: int) -> list[Kindred]:
    """Return a linear and a rotary group, or one large group."""
    if axes > 12:
        cells = tuple(f"cell-{i:05d}" for i in range(axes))
        return [_linear("cell.toml", cells)]
    half = axes - axes // 2
    rotary = Kindred(
        "spindle.toml",
        ("inertia", "viscous_friction", "coulomb_friction"),
        ("kg m2", "N m s/rad", "N m"),
        DT,
        np.array([0.0125, 0.02, 0.31]),
        NAMES[1][: axes // 2],
        "N m",
        2 * np.pi / 4096,
        "rad",
    )
    return [_linear("gantry.toml", NAMES[0][:half]), *([rotary] if axes > 1 else [])]


def _linear(config: str, names: tuple[str, ...]) -> Kindred:
    parameters, units = ("mass", "viscous_friction", "coulomb_friction"), ("kg", "N s/m", "N")
    return Kindred(config, parameters, units, DT, np.array([2.05, 5.4, 1.9]), names, "N", 5e-5, "m")


@dataclass
class FakePlant:
    """A plant of simulated rows.

    `every` is the time between two rows of an axis [s]. `odd` maps axes to their fault: "heavy", "poor", "silent" or
    "suspicious".
    """

    axes: int = 12
    every: float = 1.0
    odd: dict[str, str] = field(default_factory=dict)
    seed: int = 1

    def __post_init__(self) -> None:
        self.counters = Counters()
        self.groups = kindreds(self.axes)
        self.board = Board(self.groups, every=self.every)
        self._rng = np.random.default_rng(self.seed)
        self._number = 0
        self.samples = 0

    def run(self, seconds: float, received: float | None = None) -> None:
        """Make the rows of the given number of seconds; `received` is the time of their end, and None means now."""
        end = time.monotonic() if received is None else received
        steps = max(1, round(seconds / self.every))
        for step in range(steps):
            n = round(self.every / DT)
            self.samples += n
            for group in self.groups:
                self._rows(group, n, end - (steps - 1 - step) * self.every)

    def _rows(self, group: Kindred, n: int, received: float) -> None:
        followed = self.board.list_followed()
        axes = [i for i, name in enumerate(group.axes) if self.odd.get(name) != "silent" or self.samples < 5000]
        every = np.array([i for i in axes if group.axes[i] in followed], np.int64)
        rest = np.array([i for i in axes if group.axes[i] not in followed], np.int64)
        samples = np.arange(self.samples - n, self.samples)
        for axis in every:
            self.board.rows(self._made(group, np.full(n, axis), samples, received))
        if rest.size:
            self.board.rows(self._made(group, rest, np.full(rest.size, samples[-1]), received))

    def _made(self, group: Kindred, axis: np.ndarray, samples: np.ndarray, received: float) -> EstimateRows:
        t = (samples + 1) * DT
        q = len(group.names)
        phase = axis[:, None] * 0.7 + np.arange(q)
        drift = 1 + 0.004 * np.sin(2 * np.pi * t[:, None] / 47 + phase) + 0.001 * self._rng.standard_normal((t.size, q))
        wrong = np.array([self.odd.get(group.axes[i], "") for i in axis])
        drift[:, 0] += 0.075 * np.clip((t - 40) / 6, 0, 1) * (wrong == "heavy")
        drift[:, -1] += 0.03 * np.clip((t - 30) / 20, 0, 1) * (wrong == "suspicious")
        state = np.full(t.size, WATCHING)
        state[wrong == "poor"], state[wrong == "suspicious"] = CANNOT_TELL, SUSPICIOUS
        status = np.where(wrong == "poor", int(Status.POOR_EXCITATION | Status.STANDSTILL), 0)
        std = np.where(wrong == "fresh", np.inf, 0.004)[:, None] * group.nominal * np.ones((t.size, q))
        u = 3 * np.sign(np.sin(2 * np.pi * t / 1.3 + axis)) + 0.4 * np.sin(9 * t)
        place = 0.12 * np.sin(2 * np.pi * t / 1.3 + axis - 1.2) * (wrong != "poor")
        counts = np.round(place / group.resolution)
        return EstimateRows(
            group, axis, samples + 1, t, u, counts.astype(np.int64), drift * group.nominal, std,
            0.02 * self._rng.standard_normal(t.size), status.astype(np.uint32), state.astype(np.uint8), received,
        )  # fmt: skip

    def tell(self, axis: str, **what: object) -> int:
        """Publish a notice and return its number."""
        self._number += 1
        self.board.notice(Notice(axis, self._number, time.time(), what))
        return self._number

    def alarm(self, axis: str, parameter: str = "mass", unit: str = "kg", relative: float = 0.078) -> int:
        t = self.samples * DT
        change = Change(parameter, unit, change=2.05 * relative, std=0.011, relative=relative)
        alarm = Alarm(t, t - 1.4, (change,), statistic=31.2, threshold=17.9, tolerance=0.02)
        return self.tell(axis, **event_object(alarm, ()))

    # --- requests of the page ---

    def acknowledge(self, number: int, note: str) -> bool:
        self.tell(getattr(self.board.alarm(number), "axis", ""), event="acknowledged", alarm=number, note=note)
        return True

    def refer(self, axis: str) -> bool:
        group = self.board.group_of(axis)
        found = self.board.follow(axis, -1)
        if group is None or found is None:
            return False
        normal = dict(zip(group.names, found[0]["theta"][-1].tolist(), strict=True))
        self.tell(axis, event="reference", time=self.samples * DT, nominal=normal)
        return True

    def restart_numbers(self, axis: str) -> bool:
        self.tell(axis, event="anew", dropped=0)
        return True

    def reference(self, axis: str) -> Record | None:
        """Return the motion of the axis before any fault."""
        t = DT * np.arange(3000)
        u = 3 * np.sign(np.sin(2 * np.pi * t / 1.3)) + 0.4 * np.sin(9 * t)
        group = self.board.group_of(axis)
        counts = np.round(0.12 * np.sin(2 * np.pi * t / 1.3 - 1.2) / (group.resolution if group else 1.0))
        return Record(u, counts.astype(np.int64), DT, 5e-5, (), "normal.csv")


ODD = {
    "gantry-x2": "heavy",
    "feeder-2": "poor",
    "turntable": "silent",
    "lift-1": "suspicious",
    "cell-00042": "heavy",
    "cell-04711": "heavy",
    "cell-00815": "poor",
    "cell-09001": "silent",
}


def troubled(axes: int = 12) -> FakePlant:
    """Return a plant with a past of two minutes and some faulty axes."""
    plant = FakePlant(axes, odd=ODD)
    plant.run(120 if axes <= 12 else 70)
    names = {name for group in plant.groups for name in group.axes}
    heavy = [name for name in ODD if name in names and ODD[name] == "heavy"]
    for name in heavy:
        plant.alarm(name)
    if axes <= 12:
        old = plant.alarm("gantry-z", "coulomb_friction", "N", 0.21)
        plant.acknowledge(old, "Seal was changed on Thursday; it runs in.")
        plant.tell("gripper", event="gap", time=81.2, missing=412)
        plant.tell("turntable", event="state", time=50.0, state="cannot tell", reason="no data for 5 s")
    return plant


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--axes", type=int, default=12)
    parser.add_argument("--port", type=int, default=8127)
    options = parser.parse_args()
    plant = troubled(options.axes)
    page = serve(
        PageConfig(port=options.port), "hall-3", plant.board, plant.counters, plant,
        folder=Path.cwd(), reference=plant.reference,
    )  # fmt: skip
    print(page.start_url, *page.notes, sep="\n", flush=True)
    stop = Event()
    plant.every = 1.0 if options.axes > 12 else 0.2
    Thread(target=_go_on, args=(plant, stop), daemon=True).start()
    try:
        stop.wait()
    except KeyboardInterrupt:
        page.stop()


def _go_on(plant: FakePlant, stop: Event) -> None:
    while not stop.wait(plant.every):
        plant.run(plant.every)


if __name__ == "__main__":
    main()
