"""Samples of the recursions that are wrong without a status, on random machines.

`python -m studies.honest_recursions --out results/honest_recursions.md` runs all machines. Nothing was tuned on the
machines from number HELD_BACK on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pmfid import BCRLS, RIV, RLS, Drive, Encoder, Status
from pmfid.estimators.results import Track
from pmfid.simulation import (
    DriveParameters,
    multisine,
    position_control,
    prbs,
    quantize,
    simulate_drive,
    stop_and_go,
)
from pmfid.types import Flags, Floats
from studies.paper.truth import CartRecord, table
from studies.sections import write_page

MACHINES = 40
HELD_BACK = 20
SAMPLES = 3000
INCREMENTS = (4096, 2048, 1024, 512, 256, 128, 64, 32, 16)
METHODS = {"rls": RLS, "bcrls": BCRLS, "riv": RIV}
FORGETTING = 0.998
TIME_CONSTANT = 3.0  # of the filters [samples]
FAR, STDS = 0.05, 3.0  # an estimate is wrong beyond both
CLOSE = 0.02
#: Tones of the multisine, relative to the pole of the machine.
TONES = (0.06, 0.16, 0.35, 0.6, 0.94)


@dataclass(frozen=True)
class Bench:
    """A random machine with its sample period [s], largest input [V], and resolution with 4096 increments."""

    drive: DriveParameters
    dt: float
    largest: float
    resolution: float

    @property
    def tau(self) -> float:
        """Time constant [s]."""
        return self.drive.mass / self.drive.viscous_friction

    @property
    def speed(self) -> float:
        """Speed under the largest input."""
        force = self.largest * self.drive.input_gain - self.drive.coulomb_friction
        return force / self.drive.viscous_friction


def bench(number: int) -> Bench:
    """Return a random machine. Full speed is 60 to 400 counts per sample with 4096 increments."""
    rng = np.random.default_rng([number, 47])
    dt = float(rng.choice([0.001, 0.002, 0.005, 0.01, 0.02]))
    tau = dt * np.exp(rng.uniform(np.log(5), np.log(50)))
    mass = float(np.exp(rng.uniform(np.log(1e-2), np.log(1e2))))
    largest, gain = float(rng.choice([3.0, 6.0, 10.0])), float(np.exp(rng.uniform(np.log(0.1), np.log(10.0))))
    drive = DriveParameters(mass, mass / tau, largest * gain * rng.uniform(0.04, 0.3), gain)
    made = Bench(drive, dt, largest, 1.0)
    return Bench(drive, dt, largest, made.speed * dt / np.exp(rng.uniform(np.log(60), np.log(400))))


def _prbs(one: Bench, rng: np.random.Generator) -> Floats:
    clock = max(2, round(one.tau / one.dt * rng.uniform(0.3, 1.0)))
    return prbs(SAMPLES, clock=clock, amplitude=one.largest, rng=rng)


def _designed(one: Bench, rng: np.random.Generator) -> Floats:
    """Return pulses from rest to rest, as in the paper: full input, half of them with a brake, and a rest."""
    u, start, sign, samples = np.zeros(SAMPLES), 5, 1.0, one.tau / one.dt
    while start < SAMPLES:
        end = start + max(round(samples * rng.uniform(0.6, 2.5)), 3)
        u[start:end] = sign * one.largest
        speed = one.speed * -np.expm1((start - end) / samples)
        if rng.random() < 0.5:
            force = one.largest * one.drive.input_gain + one.drive.coulomb_friction
            brake = end + int(samples * np.log1p(speed * one.drive.viscous_friction / force))
            u[end:brake] = -sign * one.largest
            end = brake
        start, sign = end + round(samples * rng.uniform(1.5, 3.0)), -sign
    return u


def _big_then_small(one: Bench, rng: np.random.Generator) -> Floats:
    tones = np.array(TONES) * rng.uniform(0.8, 1.2, len(TONES)) / (2 * np.pi * one.tau)
    u = multisine(SAMPLES, one.dt, tones, one.largest, rng)
    small = max(0.15, 1.6 * one.drive.coulomb_friction / (one.largest * one.drive.input_gain))
    u[SAMPLES // 2 :] *= small
    return u


OPEN_LOOP: Mapping[str, Callable[[Bench, np.random.Generator], Floats]] = {
    "prbs": _prbs,
    "designed pulses": _designed,
    "big, then small": _big_then_small,
}
MOTIONS = ("prbs", "trapezoids", "stop-and-go", "designed pulses", "big, then small")


def record(one: Bench, motion: str, increments: int, number: int) -> CartRecord:
    """Return a run of the machine. Trapezoids and stop-and-go are under position control through the encoder."""
    rng = np.random.default_rng([number, MOTIONS.index(motion), 48])
    resolution = one.resolution * 4096 / increments
    phase = resolution * rng.random()
    if motion in OPEN_LOOP:
        u = OPEN_LOOP[motion](one, rng)
        return CartRecord(u, quantize(simulate_drive(one.drive, u, one.dt).x, resolution, phase), resolution)
    stroke = one.speed * one.tau * rng.uniform(1.5, 4.0)
    move = 1.5 * stroke / one.speed / rng.uniform(0.4, 0.7)
    shape = "trapezoid" if motion == "trapezoids" else "s-curve"
    reference = stop_and_go(SAMPLES, one.dt, stroke, move, move * rng.uniform(0.2, 0.8), shape)
    bandwidth, drive = min(2.0 / one.tau, 0.15 / one.dt), one.drive
    kp = drive.mass * bandwidth**2 / drive.input_gain
    kd = max(0.0, (2 * drive.mass * bandwidth - drive.viscous_friction) / drive.input_gain)
    moved, counts = position_control(
        drive, reference, one.dt, kp=kp, kd=kd, u_max=one.largest, resolution=resolution, phase=phase
    )
    return CartRecord(moved.u, counts, resolution)


@dataclass(frozen=True)
class Verdict:
    """Samples (n,) that are silently wrong, and samples with a status although mass and friction are right.

    A standstill is no doubt, and neither is the start. `error` is the largest relative error, `bar` its relative
    standard error.
    """

    silent: Flags
    doubted: Flags
    error: Floats
    bar: Floats


def judge(one: Bench, track: Track) -> Verdict:
    drive = one.drive
    true = np.array([drive.mass, drive.viscous_friction, drive.coulomb_friction])
    off, std = np.abs(track.theta - true) / true, track.theta_std / true
    status = track.status & np.uint32(Status(0xFFFF) & ~Status.STANDSTILL)
    started = (track.status & (Status.STARTING | Status.SETTLING)) == 0
    wrong = np.any((off > FAR) & (off > STDS * std), axis=1)
    worst = np.argmax(off, axis=1)
    rows = np.arange(worst.size)
    return Verdict(
        wrong & (status == 0),
        started & (status != 0) & np.all(off < CLOSE, axis=1),
        off[rows, worst],
        std[rows, worst],
    )


def verdict(method: str, motion: str, increments: int, number: int) -> Verdict:
    one = bench(number)
    run = record(one, motion, increments, number)
    estimator = METHODS[method](
        Drive(one.drive.input_gain),
        Encoder(run.resolution),
        one.dt,
        1 / (TIME_CONSTANT * one.dt),
        forgetting=FORGETTING,
    )
    return judge(one, estimator.run(run.u, run.counts))


def page(machines: int = MACHINES) -> str:
    rows = []
    for method in METHODS:
        for motion in MOTIONS:
            for increments in INCREMENTS:
                runs = [verdict(method, motion, increments, number) for number in range(machines)]
                known, held = (
                    f"{100 * np.mean([run.silent for run in part]):.2f}" if part else "–"
                    for part in (runs[:HELD_BACK], runs[HELD_BACK:])
                )
                late = np.concatenate([np.c_[run.error, run.bar][SAMPLES // 5 :] for run in runs])
                error, bar = 100 * np.median(late, axis=0)
                doubted = 100 * np.mean([run.doubted for run in runs])
                rows.append(
                    [
                        f"`{method}`",
                        motion,
                        str(increments),
                        known,
                        held,
                        f"{doubted:.2f}",
                        f"{error:.2g}",
                        f"{bar:.2g}",
                    ]
                )
    head = ["method", "motion", "increments", "silent [%]", "held back [%]", "doubted [%]", "error [%]", "std [%]"]
    return "\n".join(
        [
            "# Recursions from counts alone",
            "",
            f"Written by `python -m studies.honest_recursions`: {machines} random machines, {SAMPLES} samples, "
            f"forgetting {FORGETTING}, filter time constant {TIME_CONSTANT:g} T. Silent: samples without a status in "
            f"which a parameter is off by more than {100 * FAR:g} % and {STDS:g} standard errors, of the first "
            f"{HELD_BACK} machines and of the others, on which nothing was tuned. Doubted: samples with a status in "
            f"which all parameters are within {100 * CLOSE:g} %. Error and std: medians of the worst parameter after "
            "the start.",
            "",
            *table(head, rows),
        ]
    )


if __name__ == "__main__":
    write_page(page, __doc__)
