"""Choice of the pre-filter zeros from a record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid.estimators.base import Estimator
from pmfid.estimators.bcls import BCLS
from pmfid.estimators.configuration import like


def choose_prefilter_zeros(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> tuple[float, ...]:
    """The pre-filter zeros [rad/s] that carry most information over a record u, counts: (n,).

    Greatest determinant of W^T Z^-1 W, W = sum zeta phi^T, Z = sum zeta zeta^T: the inverse of the estimate's
    covariance up to the noise variance. The noise of phi does not enter W in the mean, so the choice is one of the
    motion, not of the noise.
    Raises what `BCLS.columns` raises.
    """
    needed = len(estimator.model.simple.equation.noisy)
    sets = estimator.plant.candidate_zeros(estimator.cutoff, estimator.memory, needed)
    batches = [like(BCLS, estimator, model=estimator.model.simple, prefilter_zeros=zeros) for zeros in sets]
    information = [_log_information(batch, u, counts) for batch in batches]
    return sets[int(np.argmax(information))]


def _log_information(batch: BCLS, u: ArrayLike, counts: ArrayLike) -> float:
    columns = batch.columns(u, counts)
    norm = np.linalg.norm(columns.zeta, axis=0)
    if columns.z.size <= norm.size or not np.all(norm > 0):
        return -np.inf
    Q, _ = np.linalg.qr(columns.zeta / norm)
    return 2 * float(np.linalg.slogdet(Q.T @ columns.phi)[1])
