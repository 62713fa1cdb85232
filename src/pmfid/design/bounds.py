"""Proved upper bounds."""

from __future__ import annotations

from pmfid.design.criteria import Criterion
from pmfid.design.problem import Float, Problem


def upper_bound(problem: Problem, rule: Criterion, u: Float, seconds: float) -> float | None:
    """None yet."""
    return None
