"""Choice of the pre-filter zeros from a record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid.estimators.base import Estimator, like, within_memory
from pmfid.estimators.bcls import BCLS

#: Candidates for the faster zero as a part of the cutoff; the slower one is a thirtieth of it.
FRACTIONS = (1 / 5, 1 / 10, 1 / 20, 1 / 40, 1 / 80)
RATIO = 30.0
#: The same for a linear process, whose zeros lie evenly in the logarithm: fastest zero, and that over the slowest.
PROCESS_FRACTIONS = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
PROCESS_RATIOS = (3.0, 10.0, 30.0)


def choose_prefilter_zeros(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> tuple[float, ...]:
    """The pre-filter zeros [rad/s] that carry most information over a record u, counts: (n,).

    Greatest determinant of W^T Z^-1 W, W = sum zeta phi^T, Z = sum zeta zeta^T: the inverse of the estimate's
    covariance up to the noise variance. The noise of phi does not enter W in the mean, so the choice is one of the
    motion, not of the noise.
    Raises what `BCLS.columns` raises.
    """
    needed = len(estimator.model.symmetric.equation.noisy)
    sets = candidates(estimator, needed)
    batches = [like(BCLS, estimator, model=estimator.model.symmetric, prefilter_zeros=zeros) for zeros in sets]
    information = [_log_information(batch, u, counts) for batch in batches]
    return sets[int(np.argmax(information))]


def candidates(estimator: Estimator, needed: int) -> list[tuple[float, ...]]:
    """Sets of `needed` zeros [rad/s] to choose from."""
    cutoff = estimator.cutoff
    if not estimator.equation.process:
        return [within_memory(cutoff * part, cutoff * part / RATIO, estimator.memory)[:needed] for part in FRACTIONS]
    ratios = PROCESS_RATIOS if needed > 1 else PROCESS_RATIOS[:1]
    return [
        tuple(-cutoff * part * float(step) for step in np.geomspace(1, 1 / ratio, needed))
        for part in PROCESS_FRACTIONS
        for ratio in ratios
    ]


def _log_information(batch: BCLS, u: ArrayLike, counts: ArrayLike) -> float:
    columns = batch.columns(u, counts)
    norm = np.linalg.norm(columns.zeta, axis=0)
    if columns.z.size <= norm.size or not np.all(norm > 0):
        return -np.inf
    Q, _ = np.linalg.qr(columns.zeta / norm)
    return 2 * float(np.linalg.slogdet(Q.T @ columns.phi)[1])
