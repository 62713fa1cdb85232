"""Logs for the study of checks: clean logs of many machines, and each fault in such a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from pmfid.config.axis import Axis as Configuration
from pmfid.records.record import Record, record_of
from pmfid.simulation import Machine, control_machine, stop_and_go
from studies import machines
from studies.friction_axes import BENCHES, FRICTIONS
from studies.machines import Axis
from studies.paper.truth import CartRecord
from studies.real_axes import REAL

#: The limits of the checks were chosen on logs of REAL; BENCHES were held back.
ALL: Mapping[str, Axis] = MappingProxyType({**REAL, **BENCHES})
MOTIONS = ("prbs", "stop-and-go", "multisine", "ramps")
#: Motions whose input takes many values.
VARIED = MOTIONS[1:]
#: Factors that make the axis's encoder coarser; a fault that only a fine encoder shows has the first two.
COARSER = (1, 4, 16)
#: Most samples of a log.
MOST = 12_000

Rng = np.random.Generator
Columns = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Run:
    """A machine's motion: input u and counts (n,), travel per count, sample period [s], and the machine."""

    u: np.ndarray
    counts: np.ndarray
    resolution: float
    dt: float
    axis: Axis
    label: str


@dataclass(frozen=True, eq=False)
class Logged:
    """Columns u and y as in a file, and the configuration for reading them."""

    columns: Columns
    configuration: Configuration
    run: Run

    def record(self) -> Record:
        """Return the record; raise UsageError if the columns are no record."""
        return record_of(self.columns, self.configuration)


def machine_of(axis: Axis, rng: Rng) -> tuple[str, Machine]:
    """Return a machine on the bench of an axis, with a random kind of friction."""
    forms: dict[str, Callable[[Axis], Machine]] = {
        **FRICTIONS,
        "uneven 20 %": lambda own: Machine(
            own.drive, uneven=0.2 * own.drive.coulomb_friction, uneven_period=own.stroke / 3
        ),
        "cogging 20 %": lambda own: Machine(
            own.drive, cogging=0.2 * own.drive.coulomb_friction, cogging_pitch=own.stroke / 7
        ),
        "load 30 %": lambda own: Machine(replace(own.drive, offset=0.3 * own.drive.coulomb_friction)),
    }
    name = str(rng.choice(list(forms)))
    return name, forms[name](axis)


def run_of(seed: int, axes: Mapping[str, Axis], motions: tuple[str, ...] = MOTIONS, coarsest: int = 16) -> Run:
    """Return a random run by its seed."""
    rng = np.random.default_rng([seed, 11])
    name, motion = str(rng.choice(list(axes))), str(rng.choice(motions))
    axis = axes[name]
    coarser = int(rng.choice([part for part in COARSER if part <= coarsest]))
    friction, machine = machine_of(axis, rng)
    return moved(axis, machine, motion, coarser, seed, f"{name}, {motion}, {friction}, 1/{coarser}")


def moved(
    axis: Axis, machine: Machine, motion: str, coarser: int, seed: int, label: str = "", limit: float | None = None
) -> Run:
    """Simulate a run of a machine; `limit` bounds the drive, and None takes a limit that most controllers never
    reach.
    """
    largest = 4 * axis.control["u_max"] if limit is None else limit
    axis = replace(axis, samples=min(axis.samples, MOST), control=MappingProxyType({**axis.control, "u_max": largest}))
    if motion != "ramps":
        record = machines.record_of(axis, machine, motion, 4096 // coarser, seed)
    else:
        record = _ramps(axis, machine, coarser, seed)
    return Run(record.u, record.counts, record.resolution, axis.dt, axis, label)


def _ramps(axis: Axis, machine: Machine, coarser: int, seed: int) -> CartRecord:
    """Simulate slow moves at constant speed, one after the other."""
    rng = np.random.default_rng([seed, 13])
    resolution = axis.resolution * coarser
    reference = stop_and_go(axis.samples, axis.dt, axis.stroke, 2 * axis.move, 0.2 * axis.dwell, "trapezoid")
    kp, kd, u_max = (axis.control[name] for name in ("kp", "kd", "u_max"))
    phase = resolution * rng.random()
    run = control_machine(machine, reference, axis.dt, resolution, kp=kp, kd=kd, u_max=u_max, phase=phase)
    return CartRecord(run.u, run.counts, resolution)


def logged(run: Run, u: np.ndarray, y: np.ndarray, kind: str = "counts", **changes: object) -> Logged:
    """Return the log of a run as columns u and y; `changes` are keys of the sections, with an underscore for the
    dot.
    """
    sections: dict[str, dict[str, object]] = {
        "record": {"input": "u", "output": "y", "output_kind": kind, "dt": run.dt},
        "encoder": {"resolution": run.resolution},
        "model": {"input_gain": run.axis.drive.input_gain},
    }
    for key, value in changes.items():
        section, _, name = key.partition("_")
        sections[section][name] = value
    columns = {"u": np.asarray(u, np.float64), "y": np.asarray(y, np.float64)}
    return Logged(columns, Configuration.model_validate(sections), run)


def clean(seed: int, axes: Mapping[str, Axis] = ALL) -> Logged:
    """Return a log without a fault, as counts or as a position."""
    run = run_of(seed, axes)
    if seed % 2:
        return logged(run, run.u, run.counts * run.resolution, "position")
    return logged(run, run.u, run.counts)


def limited(seed: int, axes: Mapping[str, Axis] = ALL) -> Logged:
    """Return a log without a fault from a drive that is at its limit.

    The time at the limit equals that of `_saturated`, whose log cuts off the drive's output.
    """
    drawn, part = np.random.default_rng([seed, 11]), np.random.default_rng([seed, 17]).uniform(0.8, 0.95)
    name, motion = str(drawn.choice(list(axes))), str(drawn.choice(("stop-and-go", "multisine")))
    axis, coarser = axes[name], int(drawn.choice(COARSER[:2]))
    friction, machine = machine_of(axis, drawn)
    free = moved(axis, machine, motion, coarser, seed)
    limit = float(np.quantile(np.abs(free.u), part))
    label = f"{name}, {motion}, {friction}, 1/{coarser}"
    run = moved(axis, machine, motion, coarser, seed, label, limit)
    return logged(run, run.u, run.counts)


# --- faults -----------------------------------------------------------------------------------------------------------


def _reversed(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes)
    return logged(run, run.u, -run.counts) if seed % 2 else logged(run, -run.u, run.counts)


def _bits(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, coarsest=4)
    bits = max(5, int(np.ptp(run.counts)).bit_length() - 1 - seed % 2)
    return logged(run, run.u, (run.counts + int(rng.integers(2**bits))) % 2**bits)


def _velocity(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, coarsest=1)
    speed = np.gradient(run.counts * run.resolution, run.dt)
    window = np.hanning(9) / np.hanning(9).sum()  # the filter of a drive
    speed = np.convolve(speed, window, mode="same")
    return logged(run, run.u, speed, "position", encoder_resolution=float(np.ptp(speed)) / 5000)


def _exchanged(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes)
    return logged(run, run.counts * run.resolution, run.u, "position")


def _whole(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes)
    return logged(run, run.u, run.counts, "position")


def _clipped(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, coarsest=1)
    low, high = np.quantile(run.counts, [0.0, rng.uniform(0.6, 0.9)])
    span = np.ptp(run.counts)
    high = min(high, run.counts.max() - 0.1 * span)
    return logged(run, run.u, np.clip(run.counts, low, int(high)))


def _stuck(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, coarsest=1)
    change = np.diff(run.counts, prepend=run.counts[0])
    speed = np.convolve(np.abs(change), np.ones(21) / 21, mode="same")
    for _ in range(3):
        start = int(rng.choice(np.flatnonzero(speed > np.quantile(speed, 0.8))))
        length = int(rng.integers(20, 100))
        if seed % 2:  # uncounted travel is lost
            change[start : start + length] = 0
        else:
            length = min(length, change.size - 1 - start)
            change[start + length] += int(np.sum(change[start : start + length]))
            change[start : start + length] = 0
    return logged(run, run.u, run.counts[0] + np.cumsum(change))


def _saturated(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, ("stop-and-go", "multisine"), coarsest=4)
    limit = float(np.quantile(np.abs(run.u), rng.uniform(0.8, 0.95)))
    return logged(run, np.clip(run.u, -limit, limit), run.counts)


def _held_output(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes)
    every = int(rng.integers(2, 11))
    return logged(run, run.u, run.counts[np.arange(run.u.size) // every * every])


def _held_input(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, VARIED)
    every = int(rng.integers(2, 11))
    return logged(run, run.u[np.arange(run.u.size) // every * every], run.counts)


def _unsigned(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, VARIED, coarsest=4)
    return logged(run, np.abs(run.u), run.counts)


def _set_point(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes, VARIED)
    early = np.roll(run.counts, -int(rng.integers(1, 8))) * run.resolution
    log = logged(run, early, run.counts, record_input="goal")
    return replace(log, columns={"goal": log.columns["u"], "y": log.columns["y"]})


def _little(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    run = run_of(seed, axes)
    if seed % 3 == 0:
        return logged(run, run.u, np.full(run.u.size, 7))
    resolution = float(np.ptp(run.counts)) * run.resolution / rng.uniform(1, 6)
    return logged(run, run.u, np.floor(run.counts * run.resolution / resolution), encoder_resolution=resolution)


def _rate_low(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    """Keep every k-th row under a random input, or a few rows of each move."""
    run = run_of(seed, axes, ("prbs", "multisine"), coarsest=4)
    period = 2.5 * run.axis.clock if "prbs" in run.label else 0.12 * (run.axis.move + run.axis.dwell) / run.dt
    keep = max(2, round(period))
    slow = replace(run, dt=run.dt * keep)
    return logged(slow, run.u[::keep], run.counts[::keep])


def _rate_high(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    """Sample the same motion far more often than the count changes."""
    run = run_of(seed, axes, coarsest=1)
    moving = run.counts[: run.counts.size // 4]
    travelled = max(1.0, float(np.mean(np.abs(np.diff(moving)))))
    times, coarser = 8, max(1, round(12 * travelled))
    rows = np.arange(moving.size * times) / times
    position = np.interp(rows, np.arange(moving.size), moving * run.resolution)
    fast = replace(run, dt=run.dt / times, resolution=run.resolution * coarser)
    return logged(fast, np.repeat(run.u[: moving.size], times), np.floor(position / fast.resolution))


def _dead_time(seed: int, rng: Rng, axes: Mapping[str, Axis]) -> Logged:
    name = str(rng.choice(list(axes)))
    axis, motion = axes[name], str(rng.choice(MOTIONS))
    machine = Machine(axis.drive, dead_time=float(rng.uniform(1.0, 5.0)) * axis.dt)
    run = moved(axis, machine, motion, int(rng.choice(COARSER[:2])), seed, f"{name}, {motion}, late")
    return logged(run, run.u, run.counts)


#: Fault -> function that makes a log with it, and the codes that name it.
FAULTS: Mapping[str, tuple[Callable[[int, Rng, Mapping[str, Axis]], Logged], frozenset[str]]] = MappingProxyType(
    {
        "reversed sign": (_reversed, frozenset({"reversed"})),
        "forgotten bits": (_bits, frozenset({"wrapped"})),
        "velocity as position": (_velocity, frozenset({"velocity"})),
        "exchanged columns": (_exchanged, frozenset({"exchanged"})),
        "counts as position": (_whole, frozenset({"unreadable"})),
        "clipped counter": (_clipped, frozenset({"clipped"})),
        "stuck counter": (_stuck, frozenset({"stuck"})),
        "saturated input": (_saturated, frozenset({"saturated"})),
        "output held": (_held_output, frozenset({"held_output"})),
        "input held": (_held_input, frozenset({"held_input"})),
        "unsigned input": (_unsigned, frozenset({"unsigned"})),
        "set point as input": (_set_point, frozenset({"command"})),
        "too little motion": (_little, frozenset({"little_motion"})),
        "sample rate too low": (_rate_low, frozenset({"rate_low"})),
        "sample rate too high": (_rate_high, frozenset({"rate_high"})),
        "dead time": (_dead_time, frozenset({"dead_time"})),
    }
)


def faulty(fault: str, seed: int, axes: Mapping[str, Axis] = ALL) -> Logged:
    """Return a log with a fault."""
    return FAULTS[fault][0](seed, np.random.default_rng([seed, 17]), axes)
