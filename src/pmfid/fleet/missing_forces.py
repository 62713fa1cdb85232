"""Forces that the model may lack: their sizes in a segment, and the error of the parameters that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from pmfid._stage import first_order
from pmfid.diagnostics.free_run import rms
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import inverse_of, long_run_covariance
from pmfid.fleet.tuning import TUNING
from pmfid.models.equation import COULOMB_BACKWARD, COULOMB_FORWARD, VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation
from pmfid.models.shapes import Square, Stribeck
from pmfid.types import Counts, Floats


def measure_forces(u: Floats, counts: Counts, resolution: float, method: IV, theta: Floats, repeats: float) -> Floats:
    """Return a row (k, 2 + p) for each force that the model with parameters theta (p,) may lack.

    A row has the size of the force, its standard error, and the changes of the parameters by a force of size 1, which
    is a plausible size. `repeats` is the number of times that each sample of u and counts (n,) occurs.
    """
    columns = method.columns_at(theta, u, counts)
    forces = _forces(method.equation, theta, velocity(counts) * (resolution / method.dt), u)
    # Rows without gaps in memory take half of the time.
    filtered, phi, zeta = map(
        np.ascontiguousarray, (_filter_forces(forces, method)[:, columns.used], columns.phi.T, columns.zeta.T)
    )
    inverse = inverse_of(zeta @ phi.T)
    moves = -inverse @ (zeta @ filtered.T)
    score = filtered - np.linalg.lstsq(zeta @ zeta.T, zeta @ filtered.T)[0].T @ zeta
    scores = score * (columns.z - inverse @ (zeta @ columns.z) @ phi)
    information = np.sum(score * (filtered + moves.T @ phi), axis=1)
    variance = np.diagonal(long_run_covariance(scores.T, method.settle_samples)) * repeats
    return np.column_stack([scores.sum(axis=1) / information, np.sqrt(variance) / np.abs(information), moves.T])


def _forces(equation: Equation, theta: Floats, speed: Floats, u: Floats) -> Floats:
    """Return the forces (k, n) of plausible size that the model may lack.

    An input may act less than in proportion, friction may grow faster than the speed, and it may be larger at rest.
    """
    values, usual, way = equation.role_values(theta), rms(speed[speed != 0]), np.sign(speed)
    coulomb = (values[COULOMB_FORWARD] + values[COULOMB_BACKWARD]) / 2
    viscous = (values[VISCOUS_FORWARD] + values[VISCOUS_BACKWARD]) / 2
    forces = [-TUNING.bends * equation.input_gain * u * np.abs(u) / rms(u)]
    if not any(isinstance(term.shape, Square) for term in equation.shaped):
        forces.append(TUNING.bends * viscous * speed * np.abs(speed) / usual)
    if not any(isinstance(term.shape, Stribeck) for term in equation.shaped):
        slow = np.exp(-((speed / (TUNING.slow_speed * usual)) ** 2))
        forces.append(TUNING.friction_at_rest * coulomb * way * slow)
    return np.stack(forces)


def _filter_forces(forces: Floats, method: IV) -> Floats:
    """Return forces (k, n) after the filters of a method. Its columns come one sample later than the forces."""
    rate = 2 / method.dt
    pole, gain = (rate - method.cutoff) / (rate + method.cutoff), method.cutoff / (rate + method.cutoff)
    late = np.concatenate([np.zeros((forces.shape[0], 1)), forces[:, :-1]], axis=1)
    for stage in range(method.order):
        b = (0.0, 2 * gain) if stage == 0 else (gain, gain)
        late = np.array([first_order(row, pole, *b)[0] for row in late])
    return late


def velocity(counts: Counts) -> Floats:
    """Return counts per sample (n,), each averaged over the time of a few counts at the usual speed."""
    change = np.diff(counts, append=counts[-1]).astype(np.float64)
    width = 2 * math.ceil(TUNING.segments_counts / max(rms(change), 1e-3) / 2) - 1
    if width < 3:
        return change
    total = np.cumsum(np.r_[np.zeros(width // 2 + 1), change, np.zeros(width // 2)])
    return np.asarray((total[width:] - total[:-width]) / width)


@dataclass(frozen=True)
class ModelError:
    """The error of the parameters (p,) by forces that the model may lack, in the unit of the parameters.

    `std` is its root mean square. `likely` is the part of `std` from forces that more likely exist than not.
    """

    std: Floats
    likely: Floats


def model_error(looks: Floats, p: int) -> ModelError:
    """Return the error of p parameters from the forces (m, k, 2 + p) in m segments, zero without segments."""
    if not len(looks):
        return ModelError(np.zeros(p), np.zeros(p))
    weight = looks[:, :, 1] ** -2.0
    total = weight.sum(axis=0)
    size, std = (weight * looks[:, :, 0]).sum(axis=0) / total, total**-0.5
    moves = (weight[:, :, None] * looks[:, :, 2:]).sum(axis=0) / total[:, None]
    chance, square = _believe(size, std)
    errors = moves**2 * square[:, None]
    return ModelError(np.sqrt(errors.sum(axis=0)), np.sqrt(errors[chance > 0.5].sum(axis=0)))


def _believe(size: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Return the probability (k,) that each force exists, and the mean square (k,) of its size.

    `size` (k,) and `std` (k,) are the estimates. A force exists with even odds. Its size is normal about 0 with the
    standard deviation 1.
    """
    variance = std**2
    share = 1 / (1 + variance)
    chance = expit((np.log(variance * share) + share * (size / std) ** 2) / 2)
    return chance, chance * (share * variance + (share * size) ** 2)
