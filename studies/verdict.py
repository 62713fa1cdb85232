"""Study of the status and the intervals: empty for a right model, set for a relevant error, with coverage.

Random machines, motions and encoders have none, one or two unmodelled effects.
`python -m studies.verdict --out results/verdict.md`
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

import pmfid
from pmfid.diagnostics.tuning import TUNING
from pmfid.estimators.configuration import change_arguments
from pmfid.simulation import Machine, multisine, prbs, stop_and_go
from pmfid.types import Floats
from studies.machines import TONES, Axis, controlled_record, driven_counts, truth
from studies.paper.truth import CartRecord, Study, Task, table, tally, triple
from studies.real_axes import axis as axis_of
from studies.record_parts import RECORD_PARTS
from studies.sections import Page, by_name

SAMPLES = (2500, 5000)
SEEDS = 40
FIRST_SEED = 700
RIGHT = "nothing"
Rng = np.random.Generator


def random_axis(rng: Rng) -> Axis:
    """Return a machine of 1e-5 to 500 kg or kg m2, with friction from 5 to 60 % of the force of a move. A move has 60
    to 400 samples and 50 to 30 000 counts."""
    mass, move = 10 ** rng.uniform(-5, 2.7), 10 ** rng.uniform(-1, 0.5)
    stroke = 10 ** rng.uniform(-1.5, 1)
    force = 5.77 * mass * stroke / move**2
    viscous = rng.uniform(0.05, 0.6) * force / (1.875 * stroke / move)
    coulomb = rng.uniform(0.05, 0.6) * force
    parameters = mass, viscous, coulomb, force / 10 ** rng.uniform(-0.3, 1.3)
    found = axis_of(parameters, move / 10 ** rng.uniform(1.8, 2.6), stroke / 10 ** rng.uniform(1.7, 4.5), stroke, move)
    return replace(found, samples=int(np.clip(found.samples, *SAMPLES)))


def _bent(u: Floats, zone: float, most: float) -> Floats:
    """Return the acting input: zero within a dead zone, and limited by `most`."""
    size = float(np.max(np.abs(u)))
    return np.sign(u) * np.clip(np.abs(u) - zone * size, 0.0, most * size)


def _levels(axis: Axis, rng: Rng) -> Floats:
    """Return steps of random heights, held as in `prbs`."""
    heights = axis.volt * rng.uniform(-1.5, 1.5, axis.samples // axis.clock + 1)
    return np.asarray(np.repeat(heights, axis.clock)[: axis.samples])


OPEN: Mapping[str, Callable[[Axis, Rng], Floats]] = MappingProxyType(
    {
        "binary": lambda axis, rng: prbs(axis.samples, clock=axis.clock, amplitude=axis.volt, rng=rng),
        "levels": _levels,
    }
)
CLOSED: Mapping[str, Callable[[Axis, Rng], Floats]] = MappingProxyType(
    {
        "stop-and-go": lambda axis, rng: stop_and_go(
            axis.samples, axis.dt, axis.stroke * rng.uniform(0.9, 1.1), axis.move, axis.dwell
        ),
        "multisine": lambda axis, rng: multisine(
            axis.samples, axis.dt, np.array(TONES) / (axis.move + axis.dwell), axis.stroke / 2, rng
        ),
    }
)
BOTH = (*OPEN, *CLOSED)


@dataclass(frozen=True)
class Wrong:
    """An unmodelled effect: further terms of the machine by name, and `zone` and `most` of the input. `zone` and `most`
    are fractions of the largest input, and `motions` are the motions that show the effect."""

    further: Callable[[Axis, Rng], dict[str, float]]
    motions: tuple[str, ...] = BOTH
    zone: float = 0.0
    most: float = 10.0


def _stribeck(axis: Axis, rng: Rng) -> dict[str, float]:
    speed = axis.stroke / axis.move * rng.uniform(0.02, 0.15)
    return {"stribeck": axis.drive.coulomb_friction * rng.uniform(0.15, 0.6), "stribeck_speed": speed}


def _cogging(axis: Axis, rng: Rng) -> dict[str, float]:
    size, pitch = rng.uniform(0.1, 0.4), axis.stroke / rng.uniform(4, 25)
    return {"cogging": axis.drive.coulomb_friction * size, "cogging_pitch": pitch, "cogging_phase": rng.uniform(0, 6)}


def _quadratic(axis: Axis, rng: Rng) -> dict[str, float]:
    return {"quadratic": axis.drive.viscous_friction / axis.speed * rng.uniform(0.1, 0.5)}


def _dead_time(axis: Axis, rng: Rng) -> dict[str, float]:
    return {"dead_time": axis.dt * rng.uniform(0.3, 2.0)}


def _load(axis: Axis, rng: Rng) -> dict[str, float]:
    return {"offset": axis.drive.coulomb_friction * rng.uniform(0.05, 0.3)}


def _noise(axis: Axis, rng: Rng) -> dict[str, float]:
    return {"force_noise": axis.drive.coulomb_friction * rng.uniform(0.05, 0.5)}


def _asymmetry(axis: Axis, rng: Rng) -> dict[str, float]:
    return {"asymmetry": rng.uniform(0.05, 0.25)}


def _nothing(axis: Axis, rng: Rng) -> dict[str, float]:
    return {}


def _both(*parts: Callable[[Axis, Rng], dict[str, float]]) -> Callable[[Axis, Rng], dict[str, float]]:
    return lambda axis, rng: {name: value for part in parts for name, value in part(axis, rng).items()}


WRONG: Mapping[str, Wrong] = MappingProxyType(
    {
        RIGHT: Wrong(_nothing),
        "Stribeck": Wrong(_stribeck),
        "quadratic": Wrong(_quadratic),
        "dead time": Wrong(_dead_time),
        "load": Wrong(_load),
        "asymmetry": Wrong(_asymmetry),
        "cogging": Wrong(_cogging),
        "force noise": Wrong(_noise),
        "dead zone, binary": Wrong(_nothing, ("binary",), zone=0.03),
        "dead zone": Wrong(_nothing, ("levels",), zone=0.05),
        "saturation": Wrong(_nothing, ("levels",), most=0.8),
        "dead time, Stribeck": Wrong(_both(_dead_time, _stribeck)),
        "cogging, load": Wrong(_both(_cogging, _load)),
        "saturation, Stribeck": Wrong(_stribeck, ("levels",), most=0.8),
        "dead zone, Stribeck": Wrong(_stribeck, ("levels",), zone=0.05),
        "quadratic, load": Wrong(_both(_quadratic, _load)),
    }
)


def run(wrong: str, seed: int) -> tuple[Axis, str, CartRecord]:
    """Return a random machine, its motion and one record of it."""
    rng = np.random.default_rng([seed, list(WRONG).index(wrong)])
    axis, what = random_axis(rng), WRONG[wrong]
    motion = what.motions[int(rng.integers(len(what.motions)))]
    further = what.further(axis, rng)
    drive = replace(axis.drive, offset=further.pop("offset", 0.0))
    machine = change_arguments(Machine(drive), further)
    return axis, motion, record(axis, machine, what, motion, rng)


def record(axis: Axis, machine: Machine, what: Wrong, motion: str, rng: Rng) -> CartRecord:
    """Simulate one run."""
    resolution = axis.resolution
    phase = resolution * rng.random()
    if motion in OPEN:
        u = OPEN[motion](axis, rng)
        acts = _bent(u, what.zone, what.most)
        return CartRecord(u, driven_counts(axis, machine, acts, resolution, phase, rng), resolution)
    return controlled_record(axis, machine, CLOSED[motion](axis, rng), resolution, phase, rng)


@dataclass(frozen=True)
class Report:
    """The result of `identify` on a record.

    error, std and half are (3,), relative to the truth; `half` is half of the interval above the value. All three are
    None for a refusal, whose reason is the status. `shown` is whether the input can show a dead zone.
    """

    status: tuple[str, ...]
    shown: bool
    error: Floats | None = None
    std: Floats | None = None
    half: Floats | None = None

    @property
    def matters(self) -> bool:
        """Return whether the error of a parameter exceeds its bars and the tolerance."""
        if self.error is None or self.std is None:
            return False
        return bool(np.any(np.abs(self.error) > np.maximum(TUNING.noise_limit * self.std, TUNING.matter_tolerance)))


def work(wrong: str, seed: int) -> Report:
    axis, motion, made = run(wrong, seed)
    shown = motion != "binary"
    model, encoder, known = pmfid.Drive(axis.drive.input_gain), pmfid.Encoder(made.resolution), truth(axis)
    try:
        found = pmfid.identify(made.u, made.counts, model=model, encoder=encoder, dt=axis.dt)
    except pmfid.NotIdentifiableError as error:
        return Report((str(error),), shown)
    assert found.interval_95 is not None
    theta, std, interval = found.theta[:3], found.theta_std[:3], found.interval_95[:3]
    return Report(found.status, shown, (theta - known) / known, std / known, (interval[:, 1] - theta) / known)


def tasks(seeds: int) -> list[Task]:
    return [(wrong, seed) for wrong in WRONG for seed in range(FIRST_SEED, FIRST_SEED + seeds)]


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = [_row(wrong, [reported for (kind, _), reported in results.items() if kind == wrong]) for wrong in WRONG]
    wrong = [reported for (kind, _), reported in results.items() if kind not in (RIGHT, "dead zone, binary")]
    rows.append(_row("all that is wrong", wrong, every=True))
    header = ["lacks", "runs", "refused", "empty", "matters", "silent", "covered [%]", "all three [%]", "length"]
    return [
        "## Random machines",
        "",
        f"{seeds} machines for each row, from 1e-5 to 500 kg or kg m2, with motion and encoder at random; `identify` "
        f"without a setting, the model `Drive`. Empty: runs without a status. Matters: runs with a parameter off by "
        f"more than {TUNING.noise_limit:g} standard deviations and {TUNING.matter_tolerance:.0%}; silent: those "
        "without a status. Covered: "
        "runs in "
        "percent whose 95 % interval contains the parameter, by mass, viscous and Coulomb friction, and all three at "
        f"once. Length: half the interval over {TUNING.normal_95} errors, both root mean squares over the runs. "
        "Under a "
        "binary input a dead zone shows nowhere: every such interval holds one, and a note says so. Length leaves such "
        "inputs out but in the row of that dead zone, and the last row leaves that out. No constant was chosen on "
        "these seeds.",
        "",
        *table([*header, "status"], rows),
    ]


def _row(name: str, reported: Sequence[Report], every: bool = False) -> list[str]:
    found = [one for one in reported if one.error is not None]
    empty, matters = [one for one in found if not one.status], [one for one in found if one.matters]
    error, half = (np.array([getattr(one, part) for one in found]).reshape(-1, 3) for part in ("error", "half"))
    inside, shown = np.abs(error) <= half, np.array([one.shown for one in found])
    shown |= not shown.any()
    length = np.sqrt(np.mean(half[shown] ** 2, axis=0) / np.mean(error[shown] ** 2, axis=0)) / TUNING.normal_95
    counts = (
        len(reported),
        len(reported) - len(found),
        len(empty),
        len(matters),
        len([one for one in empty if one.matters]),
    )
    return [
        name,
        *map(str, counts),
        triple(100 * inside.mean(axis=0), (0, 0, 0), ""),
        f"{100 * inside.all(axis=1).mean():.0f}",
        "–" if every else triple(length, (1, 1, 1), ""),
        tally([one.status for one in found]),
    ]


STUDY = Study("random", tasks, work, write)
INTRODUCTION = """\
What is found becomes a status where it may move a parameter by more than `[estimator] tolerance`, 1 % if nothing else
is said, and by more than noise; else it is a note. A status that is always up says nothing, and one that is empty
next to a wrong number is the worst."""
PAGE = Page("verdict", "Does the status mean something?", INTRODUCTION, by_name(STUDY, RECORD_PARTS), SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
