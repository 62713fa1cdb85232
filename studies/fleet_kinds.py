"""Study histories of all kinds of motion from an independent integrator: `python -m studies.fleet_kinds --axes 40`.

The study counts wrong periods that are called good, found steps of 10 %, and reports of steps that cannot be found.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pmfid import fleet
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.fleet.history import History
from pmfid.types import Floats
from studies.fleet_data import AXIS_TOML, RESOLUTION
from studies.paper.truth import table

GAIN, MASS, VISCOUS, COULOMB = 2.0, 1.07, 10.0, 2.5
#: Relative error and error in bars beyond which a good estimate is wrong.
WRONG, BARS = 0.02, 3.0
STEP = 0.1
NAMES = ("mass", "viscous_friction", "coulomb_friction")


FIELDS = """mass viscous coulomb offset gain stribeck stribeck_speed quadratic cogging pitch limit backward stiffness
damping resolution change_mass change_friction change_gain change_time""".split()  # noqa: SIM905


class Machine(ctypes.Structure):
    """The structure of fleet_machine.c."""

    _fields_ = [(name, ctypes.c_double) for name in FIELDS]


@dataclass(frozen=True)
class Kind:
    """A kind of motion.

    `motion` and `effect` are named below, and `dt` is the period of the log [s]. `seconds` is the length of the
    history, and `dwell` the range of rests [s]. `period` is the length of an estimate, and `tick` the period of the
    controller [s]. The machine is slower than NOMINAL by the factor `scale`.
    """

    motion: str
    effect: str = "none"
    dt: float = 0.01
    seconds: float = 1200.0
    dwell: tuple[float, float] = (0.3, 2.0)
    period: str = "1min"
    tick: float | None = None
    slow: float = 1.0

    @property
    def controlled(self) -> bool:
        """Whether a position controller makes the motion. Without a controller, the motion is in open loop."""
        return self.motion in ("moves", "shuttle")

    @property
    def name(self) -> str:
        dwell = f" {self.dwell[0]:g}-{self.dwell[1]:g} s" if self.motion == "moves" else ""
        held = "" if self.tick is None else ", not held"
        return f"{self.motion}{dwell}, {self.effect}, {1 / self.dt:g} Hz{held}"


EFFECTS = ("none", "stribeck", "saturation", "dead time", "quadratic", "uneven", "cogging", "load")


@cache
def library() -> Callable[..., int]:
    """Compile the integrator and return its function."""
    folder = Path(tempfile.mkdtemp())
    source = Path(__file__).with_name("fleet_machine.c")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", folder / "machine.so", source, "-lm"], check=True)
    made = ctypes.CDLL(str(folder / "machine.so")).run
    made.restype = ctypes.c_long
    return made


@dataclass(frozen=True)
class Change:
    """A change of "mass", "friction" or "gain" by a factor at a time [s]; an empty name means no change."""

    which: str = ""
    factor: float = 1.0
    time: float = math.inf


def machine(kind: Kind, k: int, rng: np.random.Generator) -> tuple[Machine, Change]:
    """Return an axis of a kind, and its change; every other axis changes."""
    mass, viscous, coulomb = np.exp(0.1 * rng.standard_normal(3)) * [MASS * kind.slow, VISCOUS, COULOMB]
    one = Machine(mass, viscous, coulomb, 0.0, GAIN, 0.0, 1.0, 0.0, 0.0, 1.0, 1e9, 1.0)
    size = rng.uniform(0.5, 1.5)
    if kind.effect == "stribeck":
        one.stribeck, one.stribeck_speed = 0.4 * coulomb * size, 0.02 * rng.uniform(0.5, 2)
    if kind.effect == "saturation":
        one.limit = 4.0 if kind.controlled else 5.0
    if kind.effect == "quadratic":
        one.quadratic = 15 * size
    if kind.effect == "uneven":
        one.backward = 1 + 0.3 * size
    if kind.effect == "cogging":
        one.cogging, one.pitch = 0.2 * coulomb * size, 0.03
    if kind.effect == "load":
        one.offset = 0.3 * coulomb * size
    one.resolution = RESOLUTION
    quick = 0.2 / (kind.tick or kind.dt)
    quick = min(quick, 40.0)
    if kind.controlled:
        one.stiffness, one.damping = mass * quick**2 / GAIN, 1.4 * mass * quick / GAIN
    one.change_mass = one.change_friction = one.change_gain = 1.0
    change = Change()
    if k % 2:
        factor = (1 + STEP) if rng.random() < 0.5 else 1 / (1 + STEP)
        which = ("mass", "friction", "gain")[(k // 2) % 3]
        setattr(one, f"change_{which}", factor)
        one.change_time = kind.seconds * rng.uniform(0.3, 0.7)
        change = Change(which, factor, one.change_time)
    return one, change


def trapezoids(kind: Kind, tick: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return position and speed of moves with limited speed and acceleration, with rests between them."""
    n = round(kind.seconds / tick)
    target, speed, at, place = np.zeros(n), np.zeros(n), 0, 0.0
    travel = rng.uniform(0.1, 0.3)
    fast, hard = rng.uniform(0.1, 0.4), rng.uniform(0.5, 2.0) / kind.slow
    if kind.effect == "saturation":
        hard *= 2.5
    while at < n:
        dwell = rng.uniform(*kind.dwell) if kind.motion == "moves" else 0.0
        rest = round(dwell / tick)
        target[at : at + rest], at = place, at + rest
        goal = rng.uniform(-travel, travel) if kind.motion == "moves" else (travel if place <= 0 else -travel)
        length, way = abs(goal - place), np.sign(goal - place)
        top = min(fast, np.sqrt(length * hard))
        ramp, whole = top / hard, length / max(top, 1e-9) + top / hard
        t = np.arange(0, whole, tick)[: max(n - at, 0)]
        v = np.clip(np.minimum(hard * t, hard * (whole - t)), 0, top)
        x = np.where(t < ramp, hard * t**2 / 2, np.where(t > whole - ramp, length - hard * (whole - t) ** 2 / 2,
                     top * (t - ramp / 2)))  # fmt: skip
        target[at : at + t.size], speed[at : at + t.size] = place + way * x, way * v
        at, place = at + t.size, goal
    return target, speed


def inputs(kind: Kind, tick: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the targets of the controller, or the inputs in open loop."""
    n = round(kind.seconds / tick)
    nothing = np.zeros(n)
    top = rng.uniform(5, 9)
    if kind.motion == "binary":
        hold = max(1, round(rng.uniform(0.15, 0.4) * kind.slow / tick))
        return np.repeat(rng.choice([-top, top], n // hold + 1), hold)[:n], nothing
    if kind.motion == "levels":
        hold = max(1, round(rng.uniform(0.2, 0.6) * kind.slow / tick))
        return np.round(np.repeat(rng.uniform(-top, top, n // hold + 1), hold)[:n], 3), nothing
    if kind.motion == "sine":
        t, f = np.arange(n) * tick, rng.uniform(0.3, 0.8) / kind.slow
        return np.round(top * np.sin(2 * np.pi * f * t) * (1 + 0.3 * np.sin(0.31 * f * t)), 3), nothing
    return trapezoids(kind, tick, rng)


def log_of(kind: Kind, k: int, seed: int) -> tuple[pl.DataFrame, Machine, Change]:
    """Return the rows of an axis, the machine and its change."""
    rng = np.random.default_rng([seed, k, *kind.name.encode()])
    one, change = machine(kind, k, rng)
    tick = kind.tick or kind.dt
    target, speed = (np.ascontiguousarray(part) for part in inputs(kind, tick, rng))
    h = min(2.5e-4, tick / 4)
    steps = round(tick / h)
    late = round(rng.uniform(0.4, 1.6) * kind.dt / h) if kind.effect == "dead time" else 0
    late = min(late, 4000)
    every = round(kind.dt / tick)
    u, counts = np.zeros(-(-target.size // every)), np.zeros(-(-target.size // every), np.int64)
    pointers = [ctypes.c_void_p(part.ctypes.data) for part in (target, speed, u, counts)]
    long = ctypes.c_long
    rows = library()(ctypes.byref(one), long(target.size), long(steps), ctypes.c_double(tick / steps), long(late),
                     long(every), *pointers)  # fmt: skip
    name = pl.repeat(f"axis-{k:02d}", rows, eager=True)
    return pl.DataFrame({"machine": name, "t": np.arange(rows) * kind.dt, "u": u, "counts": counts}), one, change


@dataclass
class Score:
    """The results for the axes of a kind.

    `good` counts the good estimates among `periods`, and `wrong` describes the wrong ones of the good estimates.
    `axes_good` and `axes_wrong` are the same for axes. `steps` counts the steps, `named` the found steps, and `said`
    the steps that were reported as beyond the record. `false` counts named axes without a step. `codes` lists findings
    with their periods, and `rate` is in million samples per second.
    """

    kind: str
    good: int = 0
    periods: int = 0
    wrong: list[str] = field(default_factory=list)
    axes_good: int = 0
    axes_wrong: list[str] = field(default_factory=list)
    steps: int = 0
    named: int = 0
    said: int = 0
    false: int = 0
    codes: str = ""
    rate: float = 0.0


@dataclass(frozen=True)
class Truth:
    """Lowest and highest value of each parameter before and after a change."""

    machine: Machine
    change: Change

    def between(self, name: str, first: float, last: float) -> tuple[float, float]:
        """Return the lowest and highest value between the times `first` and `last` [s]."""
        sides = [1.0] * (first <= self.change.time) + [self._factor(name)] * (last >= self.change.time)
        own = {"mass": self.machine.mass, "viscous_friction": self.machine.viscous}
        values = [own[name]] if name in own else [self.machine.coulomb, self.machine.coulomb * self.machine.backward]
        return min(values) * min(sides), max(values) * max(sides)

    def _factor(self, name: str) -> float:
        if self.change.which == "gain":
            return 1 / self.change.factor
        return self.change.factor if (name == "mass") == (self.change.which == "mass") else 1.0

    def wrong(self, row: Mapping[str, Any], first: float, last: float) -> list[str]:
        """Return the parameters of an estimate that are wrong beyond bars and tolerance."""
        found = []
        for name in NAMES:
            low, high = self.between(name, first, last)
            error = max(low - row[name], row[name] - high, 0.0)
            if error > WRONG * low and error > BARS * row[f"{name}_std"]:
                found.append(f"{row['axis']} {name} off by {error / low:.1%}, bar {row[f'{name}_std'] / low:.2%}")
        return found


def run(kind: Kind, axes: int, seed: int) -> Score:
    """Estimate the history of a fleet of one kind; a refusal of the whole fleet counts as one code."""
    made = [log_of(kind, k, seed) for k in range(axes)]
    log, score = pl.concat([frame for frame, _, _ in made]), Score(kind.name)
    truth = {f"axis-{k:02d}": Truth(one, change) for k, (_, one, change) in enumerate(made)}
    with tempfile.TemporaryDirectory() as name:
        config = Path(name) / "axis.toml"
        config.write_text(AXIS_TOML)
        start = time.process_time()
        try:
            found = fleet.estimate(log, axis=config, by="machine", period=kind.period, workers=1)
        except (UsageError, NotIdentifiableError) as error:
            score.codes = str(error)
            return score
        score.rate = log.height / (time.process_time() - start) / 1e6
    _periods(score, found, truth)
    _axes(score, found, truth)
    return score


def _periods(score: Score, found: History, truth: Mapping[str, Truth]) -> None:
    score.periods = found.periods.height
    good = found.periods.filter(pl.col("quality") == "good")
    score.good = good.height
    for row in good.iter_rows(named=True):
        score.wrong += truth[row["axis"]].wrong(row, row["first"], row["last"])
    codes = Counter(code for text in found.periods["findings"].to_list() for code in text.split())
    score.codes = " ".join(f"{code} {many}" for code, many in codes.most_common(4))


def _axes(score: Score, found: History, truth: Mapping[str, Truth]) -> None:
    for row in found.axes.iter_rows(named=True):
        one = truth[row["axis"]]
        if row["quality"] == "good":
            score.axes_good += 1
            score.axes_wrong += one.wrong(row, math.inf if row["kind"] == "changed" else 0.0, math.inf)
        if one.change.which:
            score.steps += 1
            score.named += row["named"]
            score.said += not row["named"] and not row["visible"] < STEP
        else:
            score.false += row["named"]


SHORT, LONG = (0.3, 2.0), (10.0, 90.0)
#: Kinds that were used during development, and kinds that were held back.
KINDS = [
    *[Kind(motion) for motion in ("binary", "sine")],
    *[Kind(motion, effect) for motion in ("levels", "shuttle", "moves") for effect in EFFECTS],
    *[Kind("moves", effect, dwell=LONG, seconds=3600) for effect in EFFECTS],
    *[Kind("binary", effect, dt=0.001, seconds=300) for effect in EFFECTS[:4]],
    *[Kind("moves", effect, dt=0.001, seconds=300) for effect in EFFECTS[:4]],
    *[Kind("levels", effect, dt=0.05, seconds=3600) for effect in EFFECTS[:4]],
    *[Kind("moves", effect, dt=0.05, seconds=3600, tick=0.01) for effect in EFFECTS[:2]],
    *[Kind("levels", effect, dt=0.25, seconds=7200, slow=20, period="10min") for effect in EFFECTS[:4]],
    *[Kind("moves", effect, dt=0.25, seconds=7200, tick=0.01, period="10min") for effect in EFFECTS[:2]],
]
HELD_BACK = [
    *[Kind("moves", effect, dwell=(30, 600), seconds=6 * 3600, period="1h") for effect in EFFECTS],
    *[Kind("moves", effect, dt=0.004, dwell=(2, 20), seconds=1200, period="5min") for effect in EFFECTS],
    *[Kind("sine", effect, dt=0.02, seconds=1800, period="5min") for effect in EFFECTS],
    *[Kind("levels", effect, dt=0.002, seconds=600) for effect in EFFECTS],
    *[Kind("binary", effect) for effect in EFFECTS[1:]],
]


def row_of(score: Score) -> list[str]:
    """Return a row of the table."""
    found = f"{score.named}, {score.said}" if score.steps else ""
    return [score.kind, f"{score.good} of {score.periods}", str(len(score.wrong)), str(score.axes_good),
            str(len(score.axes_wrong)), f"{found} of {score.steps}", str(score.false), score.codes]  # fmt: skip


HEADER = ("kind", "good periods", "wrong", "good axes", "wrong", "steps found, said", "others named", "findings")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="Of the kinds those with this in their names.")
    parser.add_argument("--held-back", action="store_true", help="The kinds that the method was not made with.")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    scores = []
    for kind in HELD_BACK if arguments.held_back else KINDS:
        if arguments.only in kind.name:
            scores.append(run(kind, arguments.axes, arguments.seed))
            print(" | ".join(row_of(scores[-1])), f"{scores[-1].rate:.2f} M/s", flush=True)
            print("\n".join(f"    {text}" for text in [*scores[-1].wrong[:4], *scores[-1].axes_wrong[:4]]))
    if arguments.out is not None:
        arguments.out.write_text("\n".join(table(HEADER, [row_of(score) for score in scores])), encoding="utf-8")


if __name__ == "__main__":
    main()
