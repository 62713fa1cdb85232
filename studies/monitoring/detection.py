"""The delay of reports on a change, the named causes, and the recovery of the estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.names import DetectorName
from pmfid.simulation.drive import DriveParameters, Schedule
from pmfid.simulation.scenarios import CART, CART_DT
from pmfid.types import Floats
from studies.monitoring.axis import INCREMENTS, calibration, changing, drive, make_riv, random_stop_and_go

MTBF_HOURS = 24.0
BEFORE, AFTER = 12.0, 8.0
#: Name, parameter of the cart, factor.
CHANGES = {
    "mass +10 %": ("mass", 1.1),
    "mass -10 %": ("mass", 0.9),
    "viscous friction +10 %": ("viscous_friction", 1.1),
    "Coulomb friction +30 %": ("coulomb_friction", 1.3),
    "input gain -10 %": ("input_gain", 0.9),
}
LOADED = 1.44
RECOVERY_INCREMENTS = (4096, 1024, 512, 256, 128)
WITHIN = 0.05


def watch_run(monitor: Monitor, u: Floats, counts: Any) -> tuple[list[Alarm], Floats]:
    """Return alarms and estimates (n, p) of a run."""
    alarms, theta = [], []
    for value, count in zip(u.tolist(), counts.tolist(), strict=True):
        estimate, events = monitor.step(value, count)
        theta.append(estimate.theta)
        alarms += [event for event in events if isinstance(event, Alarm)]
    return alarms, np.array(theta)


def changed(name: str, factor: float) -> DriveParameters:
    """Return the cart after a change."""
    return replace(CART, **{name: factor * getattr(CART, name)})


def _when(seed: int) -> float:
    """Return a random moment of a cycle after BEFORE [s]."""
    return BEFORE + 3.0 * float(np.random.default_rng((seed, 3)).random())


def work(detector: DetectorName, change: str, tolerance: float, seed: int) -> dict[str, Any]:
    """Return delay [s] (NaN without an alarm), cause, relative size, error of the estimated time [s], and earlier
    alarms.
    """
    name, factor = CHANGES[change]
    when = _when(seed)
    u, counts = changing(Schedule(((0.0, CART), (when, changed(name, factor)))), seed, INCREMENTS, when + AFTER)
    found = calibration(INCREMENTS)
    monitor = Monitor(make_riv(INCREMENTS, found.theta), found, Watch(detector, MTBF_HOURS, tolerance))
    alarms = watch_run(monitor, u, counts)[0]
    after = [alarm for alarm in alarms if alarm.time >= when]
    if not after:
        return {"delay": np.inf, "cause": "", "size": np.nan, "since": np.nan, "before": len(alarms)}
    first = after[0]
    return {
        "delay": first.time - when,
        "cause": "" if first.others else first.parameter,
        "size": first.relative,
        "since": first.changed_at - when,
        "before": len(alarms) - len(after),
    }


def recovery(increments: int, seed: int) -> tuple[float, float]:
    """Return the time until the mass stays within 5 % after the load [s].

    The first value is for constant forgetting, the second with the alarm's opening of the memory.
    """
    when = _when(seed)
    loaded = Schedule(((0.0, CART), (when, replace(CART, mass=LOADED))))
    u, counts = changing(loaded, seed, increments, when + AFTER)
    found = calibration(increments)
    constant = make_riv(increments, found.theta).run(u, counts).theta
    monitor = Monitor(make_riv(increments, found.theta), found, Watch("glr", MTBF_HOURS))
    return settled_after(constant[:, 0], when), settled_after(watch_run(monitor, u, counts)[1][:, 0], when)


def settled_after(mass: Floats, when: float) -> float:
    """Return the time [s] from the change until the mass (n,) stays within WITHIN of the load."""
    outside = np.flatnonzero(np.abs(mass / LOADED - 1) > WITHIN)
    return max(0.0, float(outside[-1] + 1) * CART_DT - when) if outside.size else 0.0


def standstill(detector: DetectorName, seed: int, hours: float = 1.0) -> dict[str, Any]:
    """Run a cart that stands for `hours` in the middle, at tolerance 0.

    Returns the alarms and the largest drift in percent: at standstill, in the first second of motion after it, and
    later.
    """
    rng = np.random.default_rng((seed, 4))
    part = random_stop_and_go(6000, rng)
    still = np.full(round(hours * 3600 / CART_DT), part[-1])
    reference = np.concatenate([part, still, part[-1] + part])
    u, counts = drive(CART, reference, INCREMENTS, rng)
    found = calibration(INCREMENTS)
    monitor = Monitor(make_riv(INCREMENTS, found.theta), found, Watch(detector, MTBF_HOURS, 0.0))
    alarms, theta = watch_run(monitor, u, counts)
    end = part.size + still.size
    drift = 100 * np.abs(theta / theta[part.size - 1] - 1)
    parts = (slice(part.size, end), slice(end, end + 100), slice(end + 100, None))
    return {"alarms": len(alarms), "drift": [drift[rows].max(axis=0) for rows in parts]}
