"""First guesses of two masses from the measured motion, which drives the load.

The force of the input is that of the motor's mass and friction, which is linear in its unknowns, and that of a load
that the measured motion of the motor drives. Such a load follows no wrong motion of the motor, so that its four
constants have few local optima. Everything is smoothed by a Gaussian kernel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from pmfid._body import drive_load
from pmfid.fit.problem import ObservedStretch
from pmfid.fit.tuning import TUNING
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class SmoothRecord:
    """A stretch after smoothing: position x (n,), force (m,), and the columns (m, 4) of a rigid motor, which are
    acceleration, velocity, direction and 1. `width` is that of the kernel [steps], and `step` is in s."""

    x: Floats
    force: Floats
    columns: Floats
    width: float
    step: float

    def loads(self, loads: Floats) -> Floats:
        """Return the smoothed forces (m, g) per mass of loads (g, 4), which are logarithms."""
        values = np.exp(loads)
        substeps = max(1, math.ceil(self.step * math.sqrt(float(np.max(values[:, 0]))) / TUNING.reach))
        return _smooth(drive_load(self.x, self.step, substeps, np.ascontiguousarray(values)), self.width)


def _smooth(signal: Floats, width: float, derivative: int = 0, cut: bool = True) -> Floats:
    """Return a smoothed signal (n, ...) or its derivative, by default without the ends that the kernel does not
    cover."""
    from scipy.ndimage import gaussian_filter1d

    smoothed = gaussian_filter1d(signal, width, axis=0, order=derivative, mode="nearest", truncate=TUNING.tail)
    end = math.ceil(TUNING.tail * width)
    return np.asarray(smoothed[end:-end] if cut else smoothed)


def smooth_record(stretch: ObservedStretch, resolution: float) -> SmoothRecord | None:
    """Return the record after a kernel that hides the rounding of the acceleration, on an even clock; None if the
    record is too short for one."""
    step, count = float(np.mean(stretch.drive.step)), stretch.drive.step.size + 1
    ends = np.append(0.0, np.cumsum(stretch.drive.step))
    clock = np.linspace(0.0, float(ends[-1]), count)
    y = np.interp(clock, stretch.times, stretch.y - stretch.y[0])
    held = np.append(stretch.drive.u, stretch.drive.u[-1])
    u = np.r_[held[0], (held[1:] + held[:-1]) / 2]  # the mean of the force before and after each instant
    for width in TUNING.kernels:
        if count < 40 * TUNING.tail * width:
            return None
        rounding = resolution * math.sqrt((1 / 12) * 3 / (8 * math.sqrt(math.pi) * width**5))
        if rounding < TUNING.rounding * np.std(_smooth(y, width, 2)):
            break
    direction = np.sign(_smooth(y, width, 1, cut=False))
    columns = [_smooth(y, width, 2) / step**2, _smooth(y, width, 1) / step, _smooth(direction, width)]
    columns.append(np.ones(columns[0].size))
    x = np.ascontiguousarray(_smooth(y, 0.7 * width, cut=False))
    return SmoothRecord(x, _smooth(u, width), np.column_stack(columns), width, step)


def find_shaken_part(stretch: ObservedStretch, resolution: float) -> ObservedStretch:
    """Return the part of a long stretch with the largest accelerations, or a short stretch itself."""
    size = stretch.drive.step.size
    # a part of a shorter stretch saves less time than the second fit, to the whole stretch, costs
    record = smooth_record(stretch, resolution) if size >= 1.5 * TUNING.part else None
    if record is None:
        return stretch
    total = np.append(0.0, np.cumsum(record.columns[:, 0] ** 2))
    width, end = min(TUNING.part, total.size - 1), (size + 1 - record.columns.shape[0]) // 2
    first = min(end + int(np.argmax(total[width:] - total[:-width])), size - TUNING.part)
    return stretch.part(first, first + TUNING.part)


def driven_guesses(stretch: ObservedStretch, resolution: float) -> list[Floats]:
    """Return guesses of (mass, viscous, Coulomb, offset, load mass, load viscous, load Coulomb, stiffness, damping),
    the best one first."""
    record = smooth_record(stretch, resolution)
    if record is None or not np.std(record.force) > 0:
        return []
    basis, _ = np.linalg.qr(record.columns / np.maximum(np.linalg.norm(record.columns, axis=0), 1e-300))
    rest = record.force - basis @ (basis.T @ record.force)
    loads = _list_loads(record)
    forces = record.loads(loads)
    forces -= basis @ (basis.T @ forces)
    gains = (forces.T @ rest) ** 2 / np.maximum(np.sum(forces**2, axis=0), 1e-300)
    likely = [loads[i] for i in np.argsort(-gains).tolist() if forces[:, i] @ rest > 0]
    guesses = [_complete(record, load) for load in distinct(likely, 0.3)[: TUNING.kept]]
    return [one for one in guesses if one[0] > 0 and one[4] > 0]


def _list_loads(record: SmoothRecord) -> Floats:
    """Return the loads (g, 4) of the scan as logarithms."""
    low = 2 * math.pi * max(1.0, 2 / (record.x.size * record.step))
    high = max(2 * low, min(2 * math.pi * TUNING.highest_load, 2 * math.pi * TUNING.fastest / record.step))
    rates = np.geomspace(low, high, max(2, round(TUNING.loads_per_octave * math.log2(high / low))))
    size = float(np.std(record.columns[:, 0])) + 1e-300
    return np.log(
        [
            (w * w, 2 * TUNING.load_ratio * w, 0.1 * TUNING.load_ratio * w, part * size)
            for w, part in product(rates.tolist(), TUNING.frictions)
        ]
    )


def _complete(record: SmoothRecord, load: Floats) -> Floats:
    """Return the masses, frictions and spring of a load (4,)."""
    X = np.column_stack([record.columns, record.loads(load[None])])
    mass, viscous, coulomb, offset, second = np.linalg.lstsq(X, record.force, rcond=None)[0].tolist()
    rate, damping, drag, rub = np.exp(load).tolist()
    friction = (max(viscous, 0.0), max(coulomb, 0.0), offset)
    return np.array([mass, *friction, second, second * drag, second * rub, second * rate, second * damping])


def distinct(points: Sequence[Floats], distance: float) -> list[Floats]:
    """Return the points that are farther than a distance from each earlier one of them."""
    kept: list[Floats] = []
    for point in points:
        if all(np.max(np.abs(point - other)) > distance for other in kept):
            kept.append(point)
    return kept
