"""The axis of the study: a cart with random moves and stops, and monitors calibrated for it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.iv import IV, RIV
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.simulation.drive import Schedule, position_control
from pmfid.simulation.scenarios import CART, CART_CONTROL, CART_DT, resolution_of
from pmfid.types import Counts, Floats

CUTOFF, FORGETTING = 50.0, 0.99
STROKE, MOVE_TIME, DWELL_TIME, VARIATION = 0.2, 0.8, 0.5, 0.25
REFERENCE_HOURS = 1.0
REFERENCE_SEED = 7
INCREMENTS = 1024


def random_stop_and_go(
    samples: int,
    rng: np.random.Generator,
    move: tuple[float, float, float] = (STROKE, MOVE_TIME, DWELL_TIME),
    dt: float = CART_DT,
) -> Floats:
    """Return a position reference (samples,) [m] of moves in both directions.

    Stroke, move time and dwell time, `move`, vary by +-VARIATION.
    """
    parts, total, x, forward = [np.zeros(1)], 1, 0.0, True
    while total < samples:
        stroke, time, dwell = np.array(move) * rng.uniform(1 - VARIATION, 1 + VARIATION, 3)
        target = stroke if forward else 0.0
        tau = np.arange(1, round(time / dt) + 1) * dt / time
        rise = np.clip(tau, 0, 1) ** 3 * (10 + np.clip(tau, 0, 1) * (6 * np.clip(tau, 0, 1) - 15))
        parts += [x + (target - x) * rise, np.full(round(dwell / dt), target)]
        total, x, forward = total + parts[-1].size + parts[-2].size, target, not forward
    return np.concatenate(parts)[:samples]


def drive(schedule: Any, reference: Floats, increments: int, rng: np.random.Generator) -> tuple[Floats, Counts]:
    """Return input and counts (n,) under position control through the encoder, from a random start phase."""
    resolution = resolution_of(increments)
    control: dict[str, Any] = {**CART_CONTROL, "resolution": resolution, "phase": resolution * rng.random()}
    motion, counts = position_control(schedule, reference, CART_DT, **control)
    return motion.u, counts


def normal_work(seed: int, increments: int, hours: float) -> tuple[Floats, Counts]:
    """Return input and counts of the unchanged cart."""
    rng = np.random.default_rng((seed, 1))
    return drive(CART, random_stop_and_go(round(hours * 3600 / CART_DT), rng), increments, rng)


def changing(schedule: Schedule, seed: int, increments: int, seconds: float) -> tuple[Floats, Counts]:
    """Return input and counts of a cart that changes by the schedule."""
    rng = np.random.default_rng((seed, 2))
    return drive(schedule, random_stop_and_go(round(seconds / CART_DT), rng), increments, rng)


def make_riv(increments: int, theta: Floats | None = None) -> RIV:
    """Return the estimator, started at theta (p,) if it is given."""
    plain = RIV(Drive(CART.input_gain), Encoder(resolution_of(increments)), CART_DT, CUTOFF, forgetting=FORGETTING)
    if theta is None:
        return plain
    initial = dict(zip(plain.names, theta.tolist(), strict=True))
    return RIV(plain.model, plain.encoder, CART_DT, CUTOFF, forgetting=FORGETTING, initial=initial)


@cache
def calibration(increments: int) -> Calibration:
    """Return the calibration from a reference record, whose parameters come from `iv`."""
    u, counts = normal_work(REFERENCE_SEED, increments, REFERENCE_HOURS)
    riv = make_riv(increments)
    theta = IV(riv.model, riv.encoder, CART_DT, CUTOFF).fit(u, counts).theta
    return calibrate(riv, theta, u, counts)
