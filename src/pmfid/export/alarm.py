"""Alarms on parameters, as the drive raises them (csrc/pmf_alarm.c)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.structures import Structured, structures

#: Logarithm of the likelihood ratio that raises an alarm: by chance about once in exp(10) = 22000 intervals.
THRESHOLD = 10.0
#: Samples between estimates that count, in memories: then their errors are nearly independent.
MEMORIES = 2.0


@dataclass(frozen=True)
class ParameterAlarm:
    """Watches a parameter by a two-sided cumulative sum of log-likelihood ratios (Page 1954).

    parameter: its name; nominal: its value in normal work; shift: the change to be noticed [unit of the parameter],
    > 0; threshold: of the sum, > 0. Raises UsageError for a value outside these bounds.
    """

    parameter: str
    nominal: float
    shift: float
    threshold: float = THRESHOLD

    def __post_init__(self) -> None:
        for name, value in (("shift", self.shift), ("threshold", self.threshold)):
            if not (math.isfinite(value) and value > 0):
                raise UsageError(f"{name} of an alarm must be positive and finite, got {value}")
        if not math.isfinite(self.nominal):
            raise UsageError(f"nominal of an alarm must be finite, got {self.nominal}")

    def interval(self, estimator: RecursiveEstimator) -> int:
        """Samples between the estimates that count. Raises UsageError for an estimator that never forgets."""
        if estimator.forgetting == 1:
            raise UsageError("an alarm needs forgetting below 1: an estimate that remembers everything follows nothing")
        return math.ceil(MEMORIES / (1 - estimator.forgetting))

    def structure(self, estimator: RecursiveEstimator) -> Structured:
        """The `pmf_alarm_config_t`. Raises UsageError for a parameter that the estimator has not."""
        if self.parameter not in estimator.names:
            raise UsageError(f"an alarm's parameter must be one of {list(estimator.names)}, got {self.parameter!r}")
        config = np.zeros((), structures(None, estimator.precision)["pmf_alarm_config_t"])
        config["parameter"] = estimator.names.index(self.parameter)
        config["interval"] = self.interval(estimator)
        for name in ("nominal", "shift", "threshold"):
            config[name] = getattr(self, name)
        return config
