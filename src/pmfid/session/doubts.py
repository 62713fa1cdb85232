"""Transfer functions: what is no estimate, and what to mind where there is one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.estimators.structure import Search
from pmfid.linear.assess import Assessment
from pmfid.linear.experiment import Experiment
from pmfid.linear.process import Process

#: The input must not be correlated with the noise by more than chance for these to be consistent without reference.
FEEDBACK = (
    "the residual is correlated with later inputs, so the input has the noise in it, as a controller feeds it back: "
    "the estimate is biased; give the reference of the controller ([record] reference) to srivc, iv or output-error"
)
IGNORED = "{method} does not use the reference of the controller; srivc, iv and output-error do"
#: A record of noise alone is refused but for so many. Poles can be tuned to any of its frequencies: for each sample the
#: chance is a part of that.
CHANCE = 1e-2
#: Less of the output explained [%] is worth a sentence.
POOR_FIT = 10.0
#: An output so many robust standard deviations off, in so small a part of the samples, is an outlier.
FAR, FEW = 10.0, 0.01


def check_known(estimator: Estimator, theta: np.ndarray, cov: np.ndarray, samples: int) -> None:
    """An estimate of nothing but noise is none, whatever its error bars."""
    variance = np.diagonal(cov)
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(cov)) and np.all(variance > 0)):
        raise NotIdentifiableError(
            f"the uncertainty of the transfer function is beyond numbers ({estimator.method}): the records do not "
            "identify it; excite the process more, or use fewer poles and zeros"
        )
    if np.all(variance > theta**2):
        raise NotIdentifiableError(
            f"no parameter of the transfer function is known to its own size ({estimator.method}): the records do not "
            "identify it; excite the process more, or use fewer poles and zeros"
        )
    top = np.array([name.startswith("b") for name in estimator.names]).nonzero()[0]
    scale = np.sqrt(variance[top])
    correlation, scaled = cov[np.ix_(top, top)] / np.outer(scale, scale), theta[top] / scale
    if scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled < chdtri(top.size, CHANCE / samples):
        offset = "" if "offset" in estimator.names else "give offset = true in [model] where it has a constant, "
        raise NotIdentifiableError(
            f"the output hardly depends on the input ({estimator.method}): chance alone gives such a numerator; "
            f"check the columns, the dead time and for outliers, {offset}excite the process more, or use fewer poles "
            "and zeros"
        )


def doubts(estimator: Estimator, theta: np.ndarray, std: np.ndarray, checks: Assessment) -> list[str]:
    """What there is to doubt in numbers that are there."""
    residual = np.concatenate(checks.residual)
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    far = int(np.sum(np.abs(residual - np.median(residual)) > FAR * spread)) if spread > 0 else 0
    found = []
    unknown = [name for name, value, s in zip(estimator.names, theta, std, strict=True) if s > abs(value)]
    if unknown:
        found.append(f"not known to its own size: {', '.join(unknown)}; fewer poles or zeros may do")
    if 0 < far <= FEW * residual.size:
        found.append(f"{far} samples of the output are far off the others, and may decide everything: leave them empty")
    if 0 <= checks.fit < POOR_FIT:
        found.append(f"the model explains {checks.fit:.2g} % of the output, no more")
    if "offset" not in estimator.names and abs(np.mean(residual)) > 0.5 * np.std(residual):
        found.append("the residual has a mean: give offset = true in [model]")
    return found


def notes_on(
    experiments: Sequence[Experiment], checks: Assessment, process: Process, referenced: bool, expected: bool
) -> list[str]:
    """What the residual tests, the poles and the records give to mind; referenced: the method uses a reference;
    expected: poles in the right half-plane were asked for."""
    found = []
    if checks.feedback and not referenced:
        found.append(FEEDBACK)
    if not checks.independent:
        found.append(
            "the residual is correlated with the input: another dead time, more poles or zeros, or another hold may "
            "explain more"
        )
    if np.any(process.poles.real > 0) and not expected:
        found.append("the transfer function is unstable: what it simulates, and so the fit, says nothing")
    missing = sum(int(np.sum(~np.isfinite(experiment.y))) for experiment in experiments)
    if missing:
        found.append(f"{missing} samples of the output are missing")
    return found


def search_notes(search: Search) -> list[str]:
    """What to mind before the best structure is taken."""
    best, found = search.best, []
    if not best.settled:
        found.append("no structure settled: the order is that of unfinished fits")
    if not best.white:
        found.append(
            "what the best structure leaves is not white noise, but the criterion takes it for that and then prefers "
            "too many poles and zeros: take the smallest structure that fits nearly as well"
        )
    if best.fit < POOR_FIT:
        found.append(f"the best structure explains {max(best.fit, 0.0):.2g} % of the output, no more: it may be chance")
    return found
