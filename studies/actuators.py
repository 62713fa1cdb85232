"""Compare `fit_servo` with its rivals on ten simulated servos: `python -m studies.actuators --out FILE`.

MuJoCo's system identification needs `mujoco[sysid]`. A missing rival is left out.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.actuators import Servo, fit_servo
from pmfid.types import Floats
from studies.servo_truth import TrueServo, simulate_servos

NAMES = ("inertia", "viscous", "coulomb", "delay")
RESOLUTION, PERIOD, TIME = 2 * math.pi / 4096, 0.01, 10.0
#: Terms of the friction models of BAM.
TERMS = {"m1": [], "m2": ["stribeck"], "m3": ["load_friction"], "m4": ["stribeck", "load_friction"]}
XML = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
<worldbody><body><joint name="joint" axis="0 1 0" armature="{inertia}" damping="{viscous}" frictionloss="{coulomb}"
 solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
<inertial pos="0 0 {place}" mass="{mass}" diaginertia="1e-8 1e-8 1e-8"/></body></worldbody>
<actuator><position name="servo" joint="joint" kp="{kp}"/></actuator>
<sensor><jointpos name="position" joint="joint"/></sensor></mujoco>"""


@dataclass(frozen=True)
class Log:
    """A servo's log: its truth, its friction model, and what was recorded."""

    truth: TrueServo
    kind: str
    t: Floats
    goal: Floats
    position: Floats

    @property
    def values(self) -> Floats:
        """True values of `NAMES`."""
        true = self.truth
        return np.array([true.inertia, true.viscous, true.coulomb, true.find_delay(self.t, self.goal)])

    @property
    def servo(self) -> Servo:
        """What a user knows: gain, loop, kind of friction, and that the joint has gravity at angle 0."""
        given = {"kp": self.truth.kp, "kd": 0.0, "loop_delay": 0.0}
        terms = list(TERMS[self.kind])
        if self.truth.gravity:
            given["gravity_angle"], terms = 0.0, [*terms, "gravity"]
        return Servo(self.truth.resolution, given, terms)


@dataclass(frozen=True)
class Outcome:
    """Estimates of `NAMES`, standard errors or NaN, whether a status doubts them, and processor time [s]."""

    theta: Floats
    std: Floats
    flagged: bool
    cpu: float


def draw_servo(number: int, kind: str) -> TrueServo:
    """Draw a servo of the size of those of BAM: armature 0.002 to 0.02 kg m2, delay of one to three samples."""
    rng = np.random.default_rng([number, 40])
    inertia = float(np.exp(rng.uniform(np.log(0.002), np.log(0.02))))
    frequency, damping = rng.uniform(15.0, 45.0), rng.uniform(0.4, 1.2)
    kp = inertia * frequency**2
    coulomb = kp * RESOLUTION * rng.uniform(5.0, 20.0)
    stribeck = coulomb * rng.uniform(0.3, 0.8) if kind in ("m2", "m4") else 0.0
    return TrueServo(
        inertia=inertia,
        viscous=2 * damping * frequency * inertia,
        coulomb=coulomb,
        kp=kp,
        delay=rng.uniform(1.0, 3.0) * PERIOD,
        resolution=RESOLUTION,
        gravity=kp * rng.uniform(0.05, 0.2) * (number % 2),
        stribeck=stribeck,
        stribeck_speed=rng.uniform(0.3, 1.0),
        load_friction=rng.uniform(0.03, 0.1) if kind in ("m3", "m4") else 0.0,
        phase=rng.random(),
    )


def make_logs(servos: int, seeds: int) -> list[list[Log]]:
    """Return logs by servo and seed: steps for half of the time, then two sines."""
    kinds = [list(TERMS)[number % 4] for number in range(servos)]
    truths = [draw_servo(number, kind) for number, kind in enumerate(kinds)]
    t, found = np.arange(0.0, TIME, PERIOD), []
    goals = [
        [_draw_goal(t, np.random.default_rng([number, seed, 41])) for seed in range(seeds)] for number in range(servos)
    ]
    flat = [(truth, kind, goal) for truth, kind, own in zip(truths, kinds, goals, strict=True) for goal in own]
    positions = simulate_servos([truth for truth, _, _ in flat], t, [goal for _, _, goal in flat])
    logs = [Log(truth, kind, t, goal, position) for (truth, kind, goal), position in zip(flat, positions, strict=True)]
    found = [logs[number * seeds : (number + 1) * seeds] for number in range(servos)]
    return found


def _draw_goal(t: Floats, rng: np.random.Generator) -> Floats:
    steps = rng.uniform(-0.7, 0.7, t.size // 40 + 1).repeat(40)[: t.size]
    sines = 0.4 * np.sin(rng.uniform(3, 7) * t) + 0.15 * np.sin(rng.uniform(9, 20) * t)
    goal = np.where(t < 0.3, 0.0, np.where(t < TIME / 2, steps, sines))
    return np.asarray(RESOLUTION * np.rint(goal / RESOLUTION))


# --- methods ----------------------------------------------------------------------------------------------------------


def fit_ours(log: Log) -> tuple[Floats, Floats, bool]:
    fit = fit_servo(log.servo, log.t, log.goal, log.position)
    rows = [fit.raw_names.index(name) for name in NAMES]
    return fit.theta[rows], fit.theta_std[rows], bool(fit.status)


def fit_derivatives(log: Log) -> tuple[Floats, Floats, bool]:
    """Fit the equation of motion by least squares on Savitzky-Golay derivatives, with the best delay of a grid."""
    from scipy.signal import savgol_filter

    position, speed, acceleration = (savgol_filter(log.position, 9, 3, deriv=k, delta=PERIOD) for k in range(3))
    best: tuple[float, Floats] = (math.inf, np.empty(0))
    columns = [acceleration, speed, np.sign(speed) * (np.abs(speed) > 0.05), np.sin(position)]
    phi = np.stack(columns[: 4 if log.truth.gravity else 3], axis=1)
    covariance = np.empty((0, 0))
    for delay in np.arange(0.0, 4 * PERIOD, PERIOD / 10):
        held = log.goal[np.maximum(np.searchsorted(log.t, log.t - delay + 1e-9, side="right") - 1, 0)]
        torque = log.truth.kp * (held - position)
        theta = np.linalg.lstsq(phi, torque, rcond=None)[0]
        residual = torque - phi @ theta
        cost = float(residual @ residual)
        if cost < best[0]:
            best = cost, np.append(theta[:3], delay)
            covariance = np.linalg.inv(phi.T @ phi) * cost / (residual.size - theta.size)
    return best[1], np.append(np.sqrt(np.diag(covariance))[:3], np.nan), False


def fit_mujoco(log: Log) -> tuple[Floats, Floats, bool]:
    """Fit armature, damping, friction loss, gravity and delay by `mujoco.sysid`, which has no other friction."""
    import mujoco
    from mujoco import sysid

    guess = {
        "inertia": log.truth.kp / 25.0**2,
        "viscous": log.truth.kp / 25.0,
        "coulomb": 5 * log.truth.kp * RESOLUTION,
    }
    place = -0.01 if log.truth.gravity else 0.0
    mass = log.truth.kp * 0.1 / 9.81 / 0.01 if log.truth.gravity else 1e-6
    spec = mujoco.MjSpec.from_string(XML.format(**guess, kp=log.truth.kp, place=place, mass=mass))
    params = sysid.ParameterDict()

    def add(name: str, value: float, modifier: Callable[[Any, Any], None] | None) -> None:
        low, high = (0.0, 4 * PERIOD) if name == "delay" else (value / 50, value * 50)
        params.add(sysid.Parameter(name, nominal=value, min_value=low, max_value=high, modifier=modifier))

    def setter(key: str) -> Callable[[Any, Any], None]:
        return lambda s, p: _set_joint(s, key, p.value[0])

    for name, key in (("inertia", "armature"), ("viscous", "damping"), ("coulomb", "frictionloss")):
        add(name, guess[name], setter(key))
    if log.truth.gravity:
        add("mass", mass, lambda s, p: setattr(s.bodies[1], "mass", p.value[0]))
    add("delay", PERIOD, None)
    data = mujoco.MjData(spec.compile())
    data.qpos[:] = log.position[0]
    state = sysid.create_initial_state(spec.compile(), data.qpos, data.qvel, data.act)
    fine = np.arange(0.0, log.t[-1], 1e-3)
    held = log.goal[np.searchsorted(log.t, fine + 1e-9, side="right") - 1]
    control = sysid.TimeSeries(fine, held[:, None])
    sensor = sysid.TimeSeries.from_names(log.t, log.position[:, None], spec.compile())
    sequences = [sysid.ModelSequences("servo", spec, "log", state, control, sensor)]

    def compare(params: Any, predicted: Any, measured: Any, model: Any, every: bool, state: Any = None) -> Any:
        delay = float(params["delay"].value[0])
        moved = np.interp(measured.times - delay, predicted.times, predicted.data[:, 0], left=log.position[0])
        own = sysid.TimeSeries(measured.times, moved[:, None], measured.signal_mapping)
        return own.data - measured.data, own, measured

    function = sysid.build_residual_fn(models_sequences=sequences, modify_residual=compare, n_threads=1)
    found, _ = sysid.optimize(params, function, optimizer="mujoco", verbose=False)
    theta = np.array([float(found[name].value[0]) for name in NAMES])
    if log.truth.gravity:  # the mass has an inertia about the axis as well
        theta[0] += float(found["mass"].value[0]) * place**2
    return theta, np.full(len(NAMES), np.nan), False


def _set_joint(spec: Any, key: str, value: float) -> None:
    joint = spec.joint("joint")
    try:
        setattr(joint, key, value)
    except (TypeError, ValueError):  # an array in some versions
        getattr(joint, key)[0] = value


METHODS: dict[str, tuple[Callable[[Log], tuple[Floats, Floats, bool]], str | None]] = {
    "pmfid": (fit_ours, None),
    "mujoco.sysid": (fit_mujoco, "mujoco"),
    "derivatives": (fit_derivatives, None),
}


def measure(log: Log, method: Callable[[Log], tuple[Floats, Floats, bool]]) -> Outcome:
    start = time.process_time()
    theta, std, flagged = method(log)
    return Outcome(theta, std, flagged, time.process_time() - start)


# --- page -------------------------------------------------------------------------------------------------------------


def write_page(logs: Sequence[Sequence[Log]], found: dict[str, list[list[Outcome]]]) -> list[str]:
    errors = {name: [_rms_error(*pair) for pair in zip(logs, own, strict=True)] for name, own in found.items()}
    lines = ["# Servos: parameters from position commands", ""]
    lines += [f"`python -m studies.actuators --servos {len(logs)} --seeds {len(logs[0])}` wrote this page: {len(logs)}"]
    lines += [f"servos with the friction models M1 to M4 of BAM, {len(logs[0])} logs of {TIME:g} s each, kp known.", ""]
    lines += ["| servo | friction | " + " | ".join(found) + " |", "|---" * (len(found) + 2) + "|"]
    for number, servo in enumerate(logs):
        cells = " | ".join(f"{100 * errors[name][number]:.2f}" for name in found)
        lines.append(f"| {number + 1} | {servo[0].kind} | {cells} |")
    lines += ["", "Error of inertia, viscous and Coulomb friction and delay [%], root mean square over the logs.", ""]
    headings = (
        "method",
        "median error [%]",
        "covered [%]",
        "silent beyond 3 bars [%]",
        "time per log [s]",
        "times ours",
    )
    lines += [f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    medians = {name: float(np.median([one.cpu for row in own for one in row])) for name, own in found.items()}
    for name, own in found.items():
        inside, silent = _count(logs, own)
        cpu = medians[name]
        shown = [f"{100 * part:.0f}" if math.isfinite(part) else "–" for part in (inside, silent)]
        lines.append(
            f"| {name} | {100 * np.median(errors[name]):.2f} | {' | '.join(shown)} | {cpu:.2f} "
            f"| {cpu / next(iter(medians.values())):.2g} |"
        )
    return [*lines, "", "Times are medians of the processor time."]


def _rms_error(logs: Sequence[Log], found: Sequence[Outcome]) -> float:
    parts = [one.theta / log.values - 1 for log, one in zip(logs, found, strict=True)]
    return float(np.sqrt(np.mean(np.square(parts))))


def _count(logs: Sequence[Sequence[Log]], found: Sequence[Sequence[Outcome]]) -> tuple[float, float]:
    """Return the parts of parameters within 1.96 bars, and beyond 3 bars without a status, of those with a bar."""
    pairs = [pair for rows in zip(logs, found, strict=True) for pair in zip(*rows, strict=True)]
    apart = np.array([np.abs(one.theta - log.values) / one.std for log, one in pairs])
    known, quiet = np.isfinite(apart), np.array([not one.flagged for _, one in pairs])[:, None]
    if not known.any():
        return math.nan, math.nan
    return float(np.mean(apart[known] < 1.96)), float(np.mean((apart > 3)[known & quiet]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write or print the page, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--servos", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args(arguments)
    logs = make_logs(options.servos, options.seeds)
    usable = {name: method for name, (method, needs) in METHODS.items() if needs is None or find_spec(needs)}
    found = {name: [[measure(log, method) for log in own] for own in logs] for name, method in usable.items()}
    text = "\n".join([*write_page(logs, found), ""])
    if options.out:
        options.out.write_text(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
