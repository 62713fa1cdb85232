"""Values that a person should not believe as they stand, said in the status and in a sentence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator, like
from pmfid.estimators.batch import BCLS, Fit
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
    if not estimator.plain or estimator.zeros:
        return
    try:
        zeros = choose_prefilter_zeros(estimator, record.u, record.counts)
        fit = like(BCLS, estimator, prefilter_zeros=zeros).fit(record.u, record.counts)
    except NotIdentifiableError as error:
        yield "uncertain", f"the estimate may be the encoder's noise, for bcls finds: {error}"
        return
    unknown = [name for name in POSITIVE if name in fit.names and not _known(fit, name)]
    if unknown:
        yield "uncertain", f"bcls cannot tell {', '.join(unknown)}: least squares may show the encoder's noise instead"
        return
    apart = np.abs(theta - fit.theta) > np.maximum(3 * fit.theta_std, 0.05 * np.abs(fit.theta))
    for name, value, other in zip(estimator.names, theta, fit.theta, strict=True):
        if apart[estimator.names.index(name)] and name in POSITIVE:
            yield (
                "biased",
                f"{name} = {value:.4g} is biased by the encoder's steps, compensation gives {other:.4g}: "
                "use bcls or bcrls, or a lower cutoff",
            )


def _known(fit: Fit, name: str) -> bool:
    return bool(fit.theta_std[fit.names.index(name)] <= 0.5 * abs(fit[name]))
