"""Bias-compensated recursive least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pmfid.estimators.recursive import RecursiveEstimator


@dataclass(frozen=True)
class BCRLS(RecursiveEstimator):
    """Bias-compensated recursive least squares (paper eq. 33 to 36).

    Needs no noise variance, and the noise may be coloured, as long as it is not correlated with the input. In exact
    arithmetic equal to the paper's recursion with the affine right-hand side of a known input gain; computed as the
    instrumental variable estimate that it is (Soderstrom, Zheng and Stoica 1999 showed it for the discrete-time
    method): the facts H^T theta = h determine the coefficients of f(s), the unknown correlation cancels the normal
    equations of the noisy columns, and what is left are the noise-direct columns as instruments. That costs less, and
    stays quiet where H^T P G passes through singularity.
    """

    method: ClassVar[str] = "bcrls"
    instrumental: ClassVar[bool] = True
