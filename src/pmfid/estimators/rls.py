"""Recursive least squares."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from pmfid.estimators.recursive import RecursiveEstimator


@dataclass(frozen=True)
class RLS(RecursiveEstimator):
    """Recursive least squares with exponential forgetting (paper eq. 33, first four lines).

    Biased where the output is noisy or coarse. With `prefilter_zeros` it estimates the extended model (paper eq. 19
    to 21): the biased estimate that the paper's compensation starts from, with the coefficients of f(s) as further
    parameters.

    directional: forget only in the directions that the samples excite (Cao and Schwartz 2000): nothing is lost at
    rest or at constant speed, however long, but to the noise of a coarse encoder, which excites, too. The memory of an
    excited direction is longer, by about the number of parameters.
    """

    method: ClassVar[str] = "rls"
    plain: ClassVar[bool] = True

    directional: bool = field(default=False, kw_only=True)

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, Any]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        if self.directional:  # the accumulated right-hand side does not follow the forgetting: innovations only
            config |= {"directional": 1, "residual_updates": 0}
        return config
