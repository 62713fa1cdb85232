"""Recursive refined instrumental variables for a linear process."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING, ClassVar, cast

from pmfid.errors import UsageError
from pmfid.estimators.auxiliary import CHECK_TIME_CONSTANTS, COPY_TIME_CONSTANTS
from pmfid.estimators.bcrls import BCRLS
from pmfid.estimators.configuration import like
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.srivc import ProcessOnly
from pmfid.filters.columns import ColumnBuilder
from pmfid.kernel.configuration import new_kernel
from pmfid.models.transfer_function import TransferFunction

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: The fastest pole that samples can tell: 2 / dt.
FASTEST = 2.0


@dataclass(frozen=True)
class RSRIVC(ProcessOnly, RecursiveEstimator):
    """Recursive simplified refined instrumental variables, continuous time (Young and Jakeman 1980).

    The process is simulated from the input alone with a slow copy of the estimate; the simulated output, filtered by
    1 / A(s) like the measured one, is the instrument. For white noise on the output no unbiased method has a smaller
    variance. The filters follow the copy and are updated once per filter time constant. The filters of the input are
    exact for its hold, so there is no error of discretisation. A copy that would be unstable, or have poles beyond
    2 / dt, is not taken; the last one stays. If the process rings for a good part of the record so far, the data have
    filters that settle sooner, and only the instruments have the filters of the process; the error bars are then too
    long rather than too short. Until the model is there and as good as `BCRLS`, the estimate is the one of `BCRLS`
    (`Status.FALLBACK`). cutoff, order, prefilter_zeros: of `BCRLS`; the time of the copy goes with cutoff. Raises
    UsageError for another model than a `TransferFunction`, or one with initial conditions.
    """

    method: ClassVar[str] = "rsrivc"
    instrumental: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not isinstance(self.model, TransferFunction):
            raise UsageError("rsrivc is for a transfer function; riv is its like for a drive")
        if self.model.initial_conditions:
            raise UsageError("rsrivc forgets the start by itself; leave initial_conditions out")
        if self.model.integrators or self.model.unstable:
            raise UsageError(
                "rsrivc simulates from rest, which drifts away without a stable process; use srivc on records"
            )
        super().__post_init__()

    def make_kernel(self, forgetting: float = 1.0) -> Kernel:
        direct = like(BCRLS, self, forgetting=forgetting)
        p = len(self.names)
        builder = ColumnBuilder(direct.equation, direct.spec)
        columns = [*builder.regressors(), builder.target(), *builder.instruments()]
        return new_kernel(
            self.precision,
            builder.network.stages,
            columns,
            encoder=self.encoder_config,
            direct=direct.recursion_config(p, True, forgetting),
            settle_samples=self.settle_samples,
            instrument=self.recursion_config(p, True, forgetting, len(columns)),
            linear=self._linear_config(builder, len(columns)),
        )

    def _linear_config(self, builder: ColumnBuilder, first: int) -> dict[str, object]:
        """The model's part of the kernel configuration."""
        model, per_sample = cast(TransferFunction, self.model), self.cutoff * self.dt
        n, update = model.n, max(1, round(1 / per_sample))
        return {
            "enabled": 1,
            "n": n,
            "m": model.m,
            "offset": int(model.offset),
            "input_node": builder.input_node(),
            "first_column": first,
            "update_samples": update,
            "settle_samples": self.settle_samples,
            "start_updates": 2 * self.settle_samples,
            "half_dt": self.dt / 2,
            "scale": [self.dt ** (n - i) for i in range(n + 1)],
            "limit": [comb(n, i) * FASTEST ** (n - i) for i in range(n)],
            "smoothing": min(1.0, update * per_sample / COPY_TIME_CONSTANTS),
            "memory": math.exp(-per_sample / CHECK_TIME_CONSTANTS),
        }
