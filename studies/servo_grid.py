"""Estimates of `fit_servo` on random servos of all kinds: `python -m studies.servo_grid --logs 160 --salt 1`.

`--wrong` gives each servo a friction or a gear that the package's model does not have.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators import Servo, fit_servo
from pmfid.errors import PmfidError
from pmfid.types import Floats
from studies.servo_truth import TrueServo, simulate_servos

RATES, BITS, TIME = (50, 100, 200, 500, 1000), (10, 12), 10.0
NAMES = ("inertia", "viscous", "coulomb", "delay", "kp")
WRONG = ("asymmetry", "ripple", "cogging", "root", "bristle", "backlash", "gearbox")


@dataclass(frozen=True)
class Case:
    """A servo, what its user knows of it, and the words of its kind."""

    truth: TrueServo
    servo: Servo
    rate: int
    kind: tuple[str, ...]


def draw_case(number: int, salt: int, wrong: bool) -> Case:
    """Draw a servo with P or PD control, a known or unknown gain, free or on a pendulum, and perhaps with a limit."""
    rng = np.random.default_rng([number, salt, 52])
    rate, bits = RATES[number % 5], BITS[number // 5 % 2]
    pendulum, known, derivative, limited = ((number >> shift) % 2 == 1 for shift in range(4))
    step, inertia = 2 * math.pi / 2**bits, float(np.exp(rng.uniform(math.log(1e-4), math.log(0.1))))
    frequency, damping = rng.uniform(15.0, 45.0), rng.uniform(0.4, 1.2)
    kp, viscous = inertia * frequency**2, 2 * damping * frequency * inertia
    truth = TrueServo(
        inertia=inertia,
        viscous=viscous * (0.6 if derivative else 1.0),
        kd=viscous * 0.4 * derivative,
        coulomb=kp * 2 * math.pi / 4096 * rng.uniform(5.0, 20.0),
        kp=kp,
        delay=rng.uniform(0.0, 3.0) / rate,
        resolution=step,
        gravity=kp * rng.uniform(0.05, 0.2) * pendulum,
        torque_limit=kp * rng.uniform(0.25, 0.5) if limited else 1e12,
        phase=rng.random(),
    )
    given = {"kp": kp} if known else {"gravity": truth.gravity} if pendulum else {}
    given |= {"kd": truth.kd} if known or not derivative else {}
    given |= {"gravity_angle": 0.0} if pendulum else {}
    terms = [name for name, used in (("gravity", pendulum and known), ("kd", derivative and not known)) if used]
    kind = [f"{rate} Hz", f"{bits} bit", "pendulum" if pendulum else "free", "kp known" if known else "kp unknown"]
    kind += ["PD" if derivative else "P", "limit" if limited else "no limit"]
    if wrong:
        law = WRONG[number % len(WRONG)]
        truth, kind = _spoil(truth, law, rng), [*kind, law]
    return Case(truth, Servo(step, given, terms), rate, tuple(kind))


def _spoil(truth: TrueServo, law: str, rng: np.random.Generator) -> TrueServo:
    """Return a servo with an effect that the package's model does not have."""
    waves, strength = float(rng.integers(3, 30)), rng.uniform(0.2, 0.6)
    effects: dict[str, dict[str, float]] = {
        "asymmetry": {"asymmetry": strength},
        "ripple": {"ripple": strength, "waves": waves},
        "cogging": {"cogging": strength * truth.coulomb, "waves": waves},
        "root": {"root": strength * truth.viscous, "viscous": truth.viscous * (1 - strength)},
        "bristle": {"bristle": truth.resolution * rng.uniform(1.0, 6.0)},
        "backlash": {"backlash": truth.resolution * rng.uniform(1.0, 6.0)},
        "gearbox": {"load_friction": 0.3 * strength, "stribeck": truth.coulomb * strength, "root": 0.2 * truth.viscous},
    }
    return replace(truth, **effects[law])


def make_cases(logs: int, salt: int, wrong: bool) -> Iterator[tuple[Case, Floats, Floats, Floats]]:
    """Yield servos with times [s], goals [rad] and positions [rad]."""
    for numbers in np.array_split(np.arange(logs), max(logs // 80, 1)):
        cases = [draw_case(number, salt, wrong) for number in numbers.tolist()]
        times = [np.arange(0.0, TIME, 1 / case.rate) for case in cases]
        goals = [draw_goal(t, np.random.default_rng([n, salt, 53])) for n, t in zip(numbers, times, strict=True)]
        positions = simulate_servos([case.truth for case in cases], times, goals)
        yield from zip(cases, times, goals, positions, strict=True)


def draw_goal(t: Floats, rng: np.random.Generator) -> Floats:
    """Return goals [rad]: steps for half of the time, then two sines."""
    steps = rng.uniform(-0.7, 0.7, 30)[np.minimum((t / 0.4).astype(int), 29)]
    sines = 0.4 * np.sin(rng.uniform(3, 7) * t) + 0.15 * np.sin(rng.uniform(9, 20) * t)
    return np.where(t < 0.3, 0.0, np.where(t < TIME / 2, steps, sines))


@dataclass(frozen=True)
class Row:
    """Errors relative to the truth, and in bars, by name; the status, and the processor time [s]."""

    kind: tuple[str, ...]
    relative: dict[str, float]
    bars: dict[str, float]
    status: tuple[str, ...]
    added: tuple[str, ...]
    cpu: float


def measure_case(case: Case, t: Floats, goal: Floats, position: Floats) -> Row:
    """Fit a log. Torques of a servo without a known torque are compared as multiples of kp."""
    start, truth = time.process_time(), case.truth
    try:
        fit = fit_servo(case.servo, t, goal, position)
    except PmfidError as error:
        return Row(case.kind, {}, {}, (f"refused: {error}",), (), time.process_time() - start)
    cpu, scale = time.process_time() - start, truth.kp if fit.servo.relative else 1.0
    true = {name: getattr(truth, name) / scale for name in NAMES} | {"delay": truth.find_delay(t, goal)}
    relative, bars = {}, {}
    for name, value, std in zip(fit.servo.unknown, fit.theta.tolist(), fit.theta_std.tolist(), strict=True):
        if name in true:
            unit = max(true[name], 1 / case.rate) if name == "delay" else true[name]
            relative[name], bars[name] = (value - true[name]) / unit, (value - true[name]) / std
    return Row(case.kind, relative, bars, fit.status, fit.added, cpu)


def write_rows(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of a table by kind."""
    errors = " | ".join(f"{name} [%]" for name in NAMES)
    yield f"| kind | logs | flagged | {errors} | covered [%] | silent | CPU [s] |"
    yield "|---" * (len(NAMES) + 6) + "|"
    for kind in ("all", *sorted({word for row in rows for word in row.kind})):
        own = [row for row in rows if kind == "all" or kind in row.kind]
        quiet = [row for row in own if not row.status]
        sizes = [[abs(row.relative[name]) for row in quiet if name in row.relative] for name in NAMES]
        bars = np.abs([value for row in quiet for value in row.bars.values()])
        medians = " | ".join(f"{100 * np.median(part):.2f}" if part else "–" for part in sizes)
        covered = f"{100 * np.mean(bars < 1.96):.0f}" if bars.size else "–"
        cpu = np.median([row.cpu for row in own])
        silent = f"{np.sum(bars > 3)} of {bars.size}"
        yield f"| {kind} | {len(own)} | {len(own) - len(quiet)} | {medians} | {covered} | {silent} | {cpu:.2f} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, print its table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=160)
    parser.add_argument("--salt", type=int, default=1)
    parser.add_argument("--wrong", action="store_true")
    options = parser.parse_args(arguments)
    rows = [measure_case(*case) for case in make_cases(options.logs, options.salt, options.wrong)]
    print("\n".join(write_rows(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
