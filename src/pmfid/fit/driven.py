"""First guesses of two masses from the measured motion, which drives the load.

The force of the input is that of the motor's mass and friction, which is linear in its unknowns, and that of a load
that the measured motion of the motor drives. Such a load follows no wrong motion of the motor, so that its four
constants have few local optima. Everything is smoothed by a Gaussian kernel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from pmfid._body import drive_load
from pmfid.fit.problem import ObservedStretch
from pmfid.fit.tuning import RELEASE_TUNING, TUNING
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class SmoothRecord:
    """A stretch after smoothing: positions x (k,) at substeps, force (m,), and the columns (m, 4) of a rigid
    motor, which are acceleration, velocity, direction and 1. `width` is that of the kernel [steps], and `step` is in s.
    `moves` (m,) is 1 where the motor moves and 0 elsewhere: static friction balances any force, so that rows at a
    standstill are 0."""

    x: Floats
    force: Floats
    columns: Floats
    width: float
    step: float
    moves: Floats

    def loads(self, loads: Floats) -> Floats:
        """Return the smoothed forces (m, g) per mass of loads (g, 4), which are logarithms."""
        forces = drive_load(self.x, self.step / TUNING.substeps, TUNING.substeps, np.ascontiguousarray(np.exp(loads)))
        return np.asarray((self.moves * _smooth(forces, self.width)).T)


def _smooth(signal: Floats, width: float, derivative: int = 0, cut: bool = True) -> Floats:
    """Return a smoothed signal (..., n) or its derivative, by default without the ends that the kernel does not
    cover."""
    from scipy.ndimage import gaussian_filter1d

    smoothed = gaussian_filter1d(signal, width, order=derivative, mode="nearest", truncate=TUNING.tail)
    end = math.ceil(TUNING.tail * width)
    return np.asarray(smoothed[..., end:-end] if cut else smoothed)


def smooth_record(stretch: ObservedStretch, resolution: float, wider: int = 0) -> SmoothRecord | None:
    """Return the record after a kernel that hides the rounding of the acceleration, or one of some `wider` kernels, on
    an even clock; None if the record is too short for one."""
    from scipy.interpolate import make_interp_spline

    step, count = float(np.mean(stretch.drive.step)), stretch.drive.step.size + 1
    ends = np.append(0.0, np.cumsum(stretch.drive.step))
    clock = np.linspace(0.0, float(ends[-1]), count)
    y = np.interp(clock, stretch.times, stretch.y - stretch.y[0])
    hidden = (i for i, width in enumerate(TUNING.kernels) if _hides(y, width, resolution))
    widths = TUNING.kernels[next(hidden, len(TUNING.kernels)) + wider :]
    if not widths or count < 40 * TUNING.tail * widths[0]:
        return None
    width, held = widths[0], np.append(stretch.drive.u, stretch.drive.u[-1])
    # the weights of the mean of a cubic over a step give a held input its size and phase at the samples
    u = np.convolve(np.pad(held, (2, 1), "edge"), np.array([-1, 13, 13, -1]) / 24, "valid")
    speed = _smooth(y, width, 1, cut=False)
    rounding = resolution * math.sqrt((1 / 12) / (4 * math.sqrt(math.pi) * width**3))
    direction = np.sign(speed) * (np.abs(speed) > 3 * rounding)  # rounding alone is below three standard deviations
    # most of the kernel's weight is on a motion whose direction is sure
    moves = (_smooth(np.abs(direction), width) > 0.5).astype(np.float64)
    columns = [_smooth(y, width, 2) / step**2, _smooth(y, width, 1) / step, _smooth(direction, width)]
    columns.append(np.ones(columns[0].size))
    x = make_interp_spline(np.arange(count), y)(np.arange(TUNING.substeps * (count - 1) + 1) / TUNING.substeps)
    return SmoothRecord(x, moves * _smooth(u, width), moves[:, None] * np.column_stack(columns), width, step, moves)


def _hides(y: Floats, width: float, resolution: float) -> bool:
    """Return whether a kernel leaves little rounding in the acceleration of positions y (n,)."""
    rounding = resolution * math.sqrt((1 / 12) * 3 / (8 * math.sqrt(math.pi) * width**5))
    return bool(rounding < TUNING.rounding * np.std(_smooth(y, width, 2)))


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


def driven_guesses(stretch: ObservedStretch, resolution: float) -> Iterator[Floats]:
    """Yield guesses of (mass, viscous, Coulomb, offset, load mass, load viscous, load Coulomb, stiffness, damping),
    each from a wider kernel than the one before."""
    for wider in TUNING.wider:
        record = smooth_record(stretch, resolution, wider)
        if record is not None and np.std(record.force) > 0:
            guess = _guess(record)
            if guess is not None and guess[0] > 0 and guess[4] > 0:
                yield guess


def _guess(record: SmoothRecord) -> Floats | None:
    """Return the guess of a smooth record, or None if no load explains a part of the force."""
    basis, _ = np.linalg.qr(record.columns / np.maximum(np.linalg.norm(record.columns, axis=0), 1e-300))
    rest = record.force - basis @ (basis.T @ record.force)
    loads = _list_loads(record)
    forces = record.loads(loads)
    forces -= basis @ (basis.T @ forces)
    gains = forces.T @ rest / np.maximum(np.linalg.norm(forces, axis=0), 1e-300)
    kinds = len(TUNING.frictions) * len(TUNING.drags)
    best = np.argmax(gains.reshape(-1, kinds), axis=0) * kinds + np.arange(kinds)  # the best rate with each friction
    likely = [i for i in best[np.argsort(-gains[best])].tolist() if gains[i] > 0]
    ends = [_refine(record, basis, rest, loads[i]) for i in likely[: TUNING.kept]]
    return _complete(record, min(ends, key=lambda end: end[0])[1]) if ends else None


def _refine(record: SmoothRecord, basis: Floats, rest: Floats, load: Floats) -> tuple[float, Floats]:
    """Return the cost and the load (4,) near a load whose force leaves least of the rest (m,) of the force. Its mass is
    eliminated (variable projection; Golub and Pereyra 1973). The `basis` (m, 4) is that of a rigid motor."""
    from scipy.optimize import least_squares

    def leave(load: Floats) -> Floats:
        force = record.loads(load[None])[:, 0]
        force -= basis @ (basis.T @ force)
        mass = max(float(rest @ force), 0.0) / max(float(force @ force), 1e-300)
        return np.asarray(rest - mass * force)

    rest = rest / np.linalg.norm(rest)
    end = least_squares(leave, load, bounds=(load - TUNING.far, load + TUNING.far), max_nfev=RELEASE_TUNING.steps)
    return float(end.cost), np.asarray(end.x)


def _list_loads(record: SmoothRecord) -> Floats:
    """Return the loads (g, 4) of the scan as logarithms."""
    low = 2 * math.pi * max(1.0, 2 / (record.x.size * record.step))
    high = max(2 * low, min(2 * math.pi * TUNING.highest_load, 2 * math.pi * TUNING.fastest / record.step))
    rates = np.geomspace(low, high, max(2, round(TUNING.loads_per_octave * math.log2(high / low))))
    size = float(np.std(record.columns[:, 0])) + 1e-300
    return np.log(
        [
            (w * w, drag * w, drag * w, friction * size)
            for w, drag, friction in product(rates.tolist(), TUNING.drags, TUNING.frictions)
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
