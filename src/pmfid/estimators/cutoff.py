"""Choice of the filters' pole and of the pre-filter's zeros."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import check_arrays, like
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import long_run_covariance, solve_with_instruments
from pmfid.estimators.ls import BCLS
from pmfid.estimators.results import Columns
from pmfid.estimators.stretches import liveliest
from pmfid.models.drive import Model
from pmfid.types import Floats

#: Tried time constants of the filters [samples]. A longer one averages the encoder's error more, and a shorter one
#: keeps more information on the mass. The first with an estimate gives the motion by which all are judged.
CUTOFF_TRIED = (10, 30, 3, 100, 300)
#: Filter time constants in the shortest record.
CUTOFF_LEAST = 30
#: Filter time constants in the shortest on-line memory, and samples in the longest filter time constant. With
#: slower filters, the recursion forgets its information before it may trust its instruments, and mostly falls back.
#: On most axes from 3e-5 kg m2 to 500 kg, 30 samples were the best value.
CUTOFF_REMEMBERED = 3
CUTOFF_SLOWEST = 30
#: Samples of the longest record that is used as a whole in each step. A longer record is represented by its
#: liveliest stretch of this length where any part of it gives the same answer. The same number of samples chooses
#: the pole of the first filters of srivc.
STRETCH = 20_000


def choose_prefilter_zeros(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> tuple[float, ...]:
    """Return the pre-filter zeros [rad/s] with the most information in a record u, counts: (n,).

    The criterion is the greatest determinant of W^T Z^-1 W, with W = sum zeta phi^T and Z = sum zeta zeta^T. This
    matrix is the inverse of the estimate's covariance, up to the variance of the noise. The noise of phi has no mean
    effect on W, so that the choice depends on the motion and not on the noise.
    Raises the errors of `BCLS.columns`.
    """
    needed = len(estimator.model.simple.equation.noisy)
    sets = estimator.plant.candidate_zeros(estimator.cutoff, estimator.memory, needed)
    batches = [like(BCLS, estimator, model=estimator.model.simple, prefilter_zeros=zeros) for zeros in sets]
    u, counts = check_arrays(u, counts)
    most = counts.size if estimator.steps is not None else min(STRETCH, counts.size)
    for samples in sorted({most, counts.size}):
        part = liveliest(estimator.encoder.position(counts), samples)
        information = [_log_information(batch, u[part], counts[part]) for batch in batches]
        if np.any(np.isfinite(information)):
            break
    return sets[int(np.argmax(information))]


def _log_information(batch: BCLS, u: ArrayLike, counts: ArrayLike) -> float:
    columns = batch.columns(u, counts)
    norm = np.linalg.norm(columns.zeta, axis=0)
    if columns.z.size <= norm.size or not np.all(norm > 0):
        return -np.inf
    Q, _ = np.linalg.qr(columns.zeta / norm)
    return 2 * float(np.linalg.slogdet(Q.T @ columns.phi)[1])


def choose_cutoff(
    models: Sequence[Model],
    encoder: Encoder,
    dt: float,
    u: Floats,
    counts: NDArray[np.int64],
    forgetting: float = 1.0,
) -> float:
    """Return the pole [rad/s] of the filters that keep most information on the parameters in the record u, counts:
    (n,).

    `models` is one model, or two models with opposite signs of the input. A `forgetting` below 1 means a recursion with
    that memory.

    The pole has the smallest determinant of the covariance of instrumental variables along one motion. If the equation
    cannot be simulated, the covariance is that of bias-compensated least squares. The minimum is flat: a factor of
    three from the best pole costs little. The liveliest stretch therefore stands for a long record if it gives an
    estimate. If no pole gives an estimate, the pole is 1 / (10 dt), and the estimator reports the fault of the record.
    """
    most = counts.size / CUTOFF_LEAST
    if forgetting < 1:
        most = min(most, CUTOFF_SLOWEST, max(1 / (1 - forgetting) / CUTOFF_REMEMBERED, min(CUTOFF_TRIED)))
    poles = [1 / (samples * dt) for samples in CUTOFF_TRIED if samples <= most] or [1 / (CUTOFF_TRIED[0] * dt)]
    for samples in sorted({min(STRETCH, counts.size), counts.size}):
        part = liveliest(encoder.position(counts), samples)
        sizes: dict[float, float] = {}
        for model in models:
            for pole, found in _columns(model, encoder, dt, poles, u[part], counts[part]):
                sizes[pole] = min(_uncertainty(*found), sizes.get(pole, np.inf))
        if np.any(np.isfinite(list(sizes.values()))):
            break
    return min(sizes, key=lambda pole: sizes[pole], default=poles[0])


def _columns(
    model: Model, encoder: Encoder, dt: float, poles: Sequence[float], u: Floats, counts: NDArray[np.int64]
) -> Iterator[tuple[float, tuple[Columns, int]]]:
    """Yield each pole with its columns and the number of samples in which the filters settle."""
    linear = model.simple if model.equation.further else model
    if IV.refuses(linear.equation):
        return _make_compensated_columns([BCLS(linear, encoder, dt, pole) for pole in poles], u, counts)
    return _make_simulated_columns([IV(linear, encoder, dt, pole) for pole in poles], u, counts)


def _make_simulated_columns(
    methods: Sequence[IV], u: Floats, counts: NDArray[np.int64]
) -> Iterator[tuple[float, tuple[Columns, int]]]:
    """Yield the columns for all poles, with the instruments from one motion."""
    for first in methods:
        with suppress(NotIdentifiableError):
            theta = first.settle_iteration(u, counts)[1]
            for method in methods:
                yield method.cutoff, (method.columns_at(theta, u, counts), method.settle_samples)
            return


def _make_compensated_columns(
    methods: Sequence[BCLS], u: Floats, counts: NDArray[np.int64]
) -> Iterator[tuple[float, tuple[Columns, int]]]:
    for method in methods:
        with suppress(NotIdentifiableError):
            zeros = choose_prefilter_zeros(method, u, counts)
            columns = like(BCLS, method, prefilter_zeros=zeros).columns(u, counts)
            yield method.cutoff, (columns, method.settle_samples)


def _uncertainty(columns: Columns, settle_samples: int) -> float:
    """Return the logarithm of the covariance's determinant; infinity if no estimate exists."""
    if columns.z.size <= columns.phi.shape[1] or not np.all(np.any(columns.zeta != 0, axis=0)):
        return np.inf
    try:
        theta, gain = solve_with_instruments(columns)
    except NotIdentifiableError:
        return np.inf
    scores = columns.zeta * (columns.z - columns.phi @ theta)[:, None]
    sign, size = np.linalg.slogdet(long_run_covariance(scores @ gain.T, settle_samples))
    return float(size) if sign > 0 and np.isfinite(size) else np.inf
