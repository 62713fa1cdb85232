"""Estimates of servos on random servos of all kinds: `python -m studies.servo_grid --servos 60 --salt 1`.

`--logs 3` gives each servo three logs. `--wrong` gives each servo an effect that the package's model does not have, and
`--effect no_load` gives every servo this one.
`--polled` stamps each row some time after its goal was sent and its position was read.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators import JointLog, Servo, fit_logs
from pmfid.errors import PmfidError
from pmfid.types import Floats
from studies.servo_truth import TrueServo, simulate_servos

RATES, BITS, TIME = (50, 100, 200, 500), (10, 12, 14), 10.0
LAWS = ("P", "PD true", "PD differenced", "PD filtered", "PID")
FRICTIONS = ("plain", "load", "Stribeck", "cogging")
WRONG = ["bristle", "backlash", "deadzone", "warming", "slew", "stiffening", "sag", "swing", "windup", "loop_period"]
NAMES = ("inertia", "viscous", "coulomb", "delay", "kp", "ki")


@dataclass(frozen=True)
class Case:
    """A servo, what its user knows of it, and the words of its kind. Its readings come `late` after their goals [s]."""

    truth: TrueServo
    servo: Servo
    rate: int
    kind: tuple[str, ...]
    late: float = 0.0


def draw_case(number: int, salt: int, effects: Sequence[str]) -> Case:
    """Draw a servo with a known gain, or with a known pendulum, and with one of some effects of `_spoil`. Its user does
    not know its law and its friction."""
    rng = np.random.default_rng([number, salt, 52])
    law, friction = LAWS[number % 5], FRICTIONS[number // 5 % 4]
    rate, bits = int(rng.choice(RATES)), int(rng.choice(BITS))
    pendulum, limited = bool(rng.random() < 0.5), bool(rng.random() < 0.3)
    known = not pendulum or bool(rng.random() < 0.5)
    inertia = float(np.exp(rng.uniform(math.log(1e-4), math.log(0.1))))
    frequency, damping = rng.uniform(15.0, 45.0), rng.uniform(0.4, 1.2)
    kp, viscous = inertia * frequency**2, 2 * damping * frequency * inertia
    coulomb = kp * 2 * math.pi / 4096 * rng.uniform(5.0, 20.0)
    of_law = {
        "PD true": {"kd_true": 0.4 * viscous},
        "PD differenced": {"kd": 0.4 * viscous},
        "PD filtered": {"kd_filtered": 0.4 * viscous, "velocity_filter": rng.uniform(1e-3, 6e-3)},
        "PID": {"kd": 0.4 * viscous, "ki": kp * rng.uniform(1.0, 6.0)},
    }
    of_friction = {
        "load": {"load_friction": rng.uniform(0.03, 0.15)},
        "Stribeck": {"stribeck": coulomb * rng.uniform(0.3, 0.8), "stribeck_speed": rng.uniform(0.2, 1.0)},
        "cogging": {"cogging": 0.3 * coulomb, "waves": float(rng.integers(5, 30))},
    }
    truth = TrueServo(
        inertia=inertia,
        viscous=viscous * (1.0 if law == "P" else 0.6),
        coulomb=coulomb,
        kp=kp,
        delay=rng.uniform(0.0, 0.03),
        resolution=2 * math.pi / 2**bits,
        gravity=kp * rng.uniform(0.05, 0.2) * pendulum,
        torque_limit=kp * rng.uniform(0.25, 0.5) if limited else 1e12,
        phase=rng.random(),
        **of_law.get(law, {}),
        **of_friction.get(friction, {}),
    )
    given = {"kp": kp} if known else {"gravity": truth.gravity}
    kind = [law, friction, f"{rate} Hz", f"{bits} bit", "pendulum" if pendulum else "free"]
    kind += ["kp known" if known else "kp unknown", "limit" if limited else "no limit"]
    if effects:
        effect = effects[number % len(effects)]
        truth, kind = _spoil(truth, effect, rng), [*kind, effect]
    return Case(truth, Servo(truth.resolution, given), rate, tuple(kind))


def _spoil(truth: TrueServo, effect: str, rng: np.random.Generator) -> TrueServo:
    """Return a servo with an effect. The package's model has the limit that falls to 0 at a speed without load."""
    strength, step = rng.uniform(0.2, 0.6), truth.resolution * rng.uniform(1.0, 6.0)
    limit = min(truth.torque_limit, 0.5 * truth.kp)
    effects: dict[str, dict[str, float]] = {
        "bristle": {"bristle": step},
        "backlash": {"backlash": step},
        "deadzone": {"deadzone": strength * truth.coulomb},
        "warming": {"warming": strength},
        "slew": {"slew": 10.0 * strength},
        "stiffening": {"stiffening": strength},
        "no_load": {"no_load": 25.0 * strength, "torque_limit": limit},
        "sag": {"sag": strength},
        "swing": {"swing": 0.5 * strength},
        "windup": {"windup": 0.15 * strength / truth.kp},
        "loop_period": {"loop_period": round(20 * strength) * 1e-3},
    }
    return replace(truth, **effects[effect])


def make_cases(
    servos: int, salt: int, effects: Sequence[str], logs: int, polled: bool
) -> list[tuple[Case, list[JointLog]]]:
    """Return servos with logs. In a log that polls, each row sends a goal, reads the position and has a stamp."""
    cases = [draw_case(number, salt, effects) for number in range(servos)]
    cases = [replace(case, late=0.4 * polled / case.rate) for case in cases]
    flat = [(case, np.random.default_rng([n, salt, 53, k])) for n, case in enumerate(cases) for k in range(logs)]
    sent = [np.arange(0.0, TIME, 1 / case.rate) for case, _ in flat]
    goals = [draw_goal(t, rng) for t, (_, rng) in zip(sent, flat, strict=True)]
    read, stamped = (
        [t + case.late * rng.uniform(low, low + 0.5, t.size) for t, (case, rng) in zip(sent, flat, strict=True)]
        for low in (0.75, 1.5)
    )
    positions = simulate_servos([case.truth for case, _ in flat], sent, goals, read)
    made = [
        JointLog("joint", t, goal, position, case.truth.resolution)
        for (case, _), t, goal, position in zip(flat, stamped, goals, positions, strict=True)
    ]
    return [(case, made[k * logs : (k + 1) * logs]) for k, case in enumerate(cases)]


def draw_goal(t: Floats, rng: np.random.Generator) -> Floats:
    """Return goals [rad]: steps for half of the time, then two sines."""
    steps = rng.uniform(-0.7, 0.7, 30)[np.minimum((t / 0.4).astype(int), 29)]
    sines = 0.4 * np.sin(rng.uniform(3, 7) * t) + 0.15 * np.sin(rng.uniform(9, 20) * t)
    return np.where(t < 0.3, 0.0, np.where(t < TIME / 2, steps, sines))


@dataclass(frozen=True)
class Row:
    """Relative errors, errors in standard errors and relative standard errors by name; status and time [s]."""

    kind: tuple[str, ...]
    relative: dict[str, float]
    bars: dict[str, float]
    widths: dict[str, float]
    status: tuple[str, ...]
    added: tuple[str, ...]
    cpu: float


def measure_case(case: Case, logs: Sequence[JointLog]) -> Row:
    """Fit the logs of a servo."""
    start, truth = time.process_time(), case.truth
    try:
        fit = fit_logs(case.servo, logs)
    except PmfidError as error:
        return Row(case.kind, {}, {}, {}, (f"refused: {error}",), (), time.process_time() - start)
    cpu = time.process_time() - start
    true = {name: getattr(truth, name) for name in NAMES} | {"delay": truth.find_delay(logs[0].t, logs[0].goal)}
    true["delay"] -= case.late
    true["inertia"] *= 1 + truth.swing * float(np.mean(np.cos(logs[0].position)))
    if "kd" not in fit.added:  # friction in the loop and in the joint are one
        true["viscous"] += truth.kd + truth.kd_true + truth.kd_filtered
    relative, bars, widths = {}, {}, {}
    for name, value, std in zip(fit.raw_names, fit.theta.tolist(), fit.theta_std.tolist(), strict=True):
        if true.get(name):
            unit = max(abs(true[name]), 1 / case.rate) if name == "delay" else true[name]
            relative[name], bars[name] = (value - true[name]) / unit, (value - true[name]) / std
            widths[name] = std / unit
    return Row(case.kind, relative, bars, widths, fit.status, fit.added, cpu)


def write_rows(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table by kind."""
    errors = " | ".join(f"{name} [%]" for name in NAMES)
    lines = [f"| kind | servos | flagged | {errors} | covered [%] | of inertia | beyond 3 std | width | CPU [s] |"]
    lines.append("|---" * (len(NAMES) + 8) + "|")
    for kind in ("all", *sorted({word for row in rows for word in row.kind})):
        own = [row for row in rows if kind == "all" or kind in row.kind]
        sizes = [[abs(row.relative[name]) for row in own if name in row.relative] for name in NAMES]
        bars = np.abs([value for row in own for value in row.bars.values()])
        inertia = np.abs([row.bars["inertia"] for row in own if "inertia" in row.bars])
        silent = [value for row in own if not row.status for value in row.bars.values()]
        medians = " | ".join(f"{100 * np.median(part):.2f}" if part else "–" for part in sizes)
        covered, of_inertia = (f"{100 * np.mean(part < 1.96):.0f}" if part.size else "–" for part in (bars, inertia))
        rms = np.sqrt(np.mean(np.square([row.relative.get("inertia", 0.0) for row in own])))
        width = np.mean([row.widths.get("inertia", 0.0) for row in own]) / max(rms, 1e-12)
        flagged, cpu = sum(bool(row.status) for row in own), np.median([row.cpu for row in own])
        beyond = f"{np.sum(np.abs(silent) > 3)} of {len(silent)}"
        cells = (kind, len(own), flagged, medians, covered, of_inertia, beyond, f"{width:.2f}", f"{cpu:.1f}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, print its table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--servos", type=int, default=60)
    parser.add_argument("--logs", type=int, default=1)
    parser.add_argument("--salt", type=int, default=1)
    parser.add_argument("--wrong", dest="effects", action="store_const", const=WRONG, default=())
    parser.add_argument("--effect", dest="effects", nargs=1)
    parser.add_argument("--polled", action="store_true")
    parser.add_argument("--verbose", action="store_true", help="one line for each servo")
    options = parser.parse_args(arguments)
    rows = []
    for case, logs in make_cases(options.servos, options.salt, options.effects, options.logs, options.polled):
        rows.append(measure_case(case, logs))
        if options.verbose:
            print(rows[-1], flush=True)
    print(f"# Servos\n\n{options.servos} random servos with {options.logs} logs of {TIME:.0f} s each.\n")
    print(*write_rows(rows), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
