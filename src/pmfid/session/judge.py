"""Values that a person should not believe as they stand, said in the status and in a sentence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BCLS
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.session.records import Record

#: Parameters that are positive in every machine.
POSITIVE = ("mass", "viscous_friction", "coulomb_friction")

Finding = tuple[str, str]


def judge(
    estimator: Estimator, record: Record, theta: np.ndarray, std: np.ndarray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Flags and sentences on the estimate theta (p,) with its standard deviations std (p,)."""
    found = [*_sizes(estimator, theta, std), *_bias(estimator, record, theta)]
    return tuple(dict.fromkeys(flag for flag, _ in found)), tuple(sentence for _, sentence in found)


def _sizes(estimator: Estimator, theta: np.ndarray, std: np.ndarray) -> Iterator[Finding]:
    for name, value, deviation in zip(estimator.names, theta, std, strict=True):
        if name not in POSITIVE:
            continue
        if value + 3 * deviation < 0:
            yield "implausible", f"{name} is negative: check sign and scale of the input and the encoder"
        elif deviation > 0.5 * abs(value):
            yield "uncertain", f"{name} is not known to half its value: excite it more, or lower the cutoff"


def _bias(estimator: Estimator, record: Record, theta: np.ndarray) -> Iterator[Finding]:
    """Least squares against bias-compensated least squares on the same record."""
    if estimator.instrumental or estimator.zeros:
        return
    compensated = BCLS(estimator.model, estimator.encoder, estimator.dt, estimator.cutoff, order=estimator.order)
    try:
        zeros = choose_prefilter_zeros(compensated, record.u, record.counts)
        compensated = BCLS(
            estimator.model,
            estimator.encoder,
            estimator.dt,
            estimator.cutoff,
            order=estimator.order,
            prefilter_zeros=zeros,
        )
        fit = compensated.fit(record.u, record.counts)
    except NotIdentifiableError:
        return
    apart = np.abs(theta - fit.theta) > np.maximum(3 * fit.theta_std, 0.05 * np.abs(fit.theta))
    for name, value, other in zip(estimator.names, theta, fit.theta, strict=True):
        if apart[estimator.names.index(name)] and name in POSITIVE:
            yield (
                "biased",
                f"{name} = {value:.4g} is biased by the encoder's steps, compensation gives {other:.4g}: "
                "use bcls or bcrls, or a lower cutoff",
            )
