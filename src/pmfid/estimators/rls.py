"""Recursive least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pmfid.estimators.recursive import RecursiveEstimator


@dataclass(frozen=True)
class RLS(RecursiveEstimator):
    """Recursive least squares with exponential forgetting (paper eq. 33, first four lines).

    Biased where the output is noisy or coarse. With `prefilter_zeros` it estimates the extended model (paper eq. 19
    to 21): the biased estimate that the paper's compensation starts from, with the coefficients of f(s) as further
    parameters.
    """

    method: ClassVar[str] = "rls"

    def scheme_refused(self) -> str:
        return ""
