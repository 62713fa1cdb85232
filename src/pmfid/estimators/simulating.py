"""Estimators with an auxiliary model of a machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pmfid.estimators.base import Estimator
from pmfid.models.equation import Equation


@dataclass(frozen=True)
class Simulating(Estimator):
    """An `Estimator` that simulates the motion from the input alone, so that it must know what stands in the equation;
    of a pre-filter it has no unknowns."""

    knows_shapes: ClassVar[bool] = True

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        refused = super().refuses(equation.at_once)
        if refused or not equation.without_simulation:
            return refused
        return (
            f"{cls.method} simulates the motion, which it cannot for this equation: "
            f"{equation.without_simulation}; use ls, bcls, rls or bcrls"
        )

    @property
    def _extra(self) -> int:
        return 0
