"""The off-line method of first choice: maximum likelihood of the simulated motion, with forces compared (theory of
`pmfid.fit`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Simulating
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import check_arrays, check_size
from pmfid.estimators.results import Fit
from pmfid.findings import MOVE
from pmfid.fit.fit import Fitted, fit
from pmfid.fit.machine import Excitation, machine_of
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class MotionFit(Simulating, BatchEstimator):
    """Maximum likelihood: the motion, simulated from the input alone, that the counts allow.

    Each count is an interval for the position. If no motion of the model is in all intervals, forces that the model
    lacks enter with Gaussian priors, and the rest is a force or an error of the encoder that wanders. The filters of
    other methods, `cutoff` and `order`, are not used.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, MotionFit, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = MotionFit(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> print(round(fit["mass"], 4), CART.mass)
    1.07 1.07
    """

    method: ClassVar[str] = "fit"
    knows_elastic: ClassVar[bool] = True

    def _check_steps(self) -> None:
        """Any step is possible, because the motion is exact over any time."""

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        return self.summarise(self.examine(*check_arrays(u, counts)))

    def examine(
        self,
        u: Floats,
        counts: Counts,
        there: Flags | None = None,
        temperature: Floats | None = None,
        elastic: bool = False,
    ) -> Fitted:
        """Return the fit of a record, u (n,) and counts (n,), with its comparison of forces. The search for forces ends
        where two masses explain every count, if the axis may be `elastic`.

        An input of NaN is a gap, after which the motion starts again. `there` (n,) marks the counts in use, None all.
        Friction may follow a `temperature` (n,), and the parameters belong to its mean.
        Raises NotIdentifiableError if the axis does not move, or if no motion of the model follows it.
        """
        with np.errstate(all="ignore"):  # motions far from the record may overflow
            return fit(self.problem(u, counts, there, temperature), elastic=elastic)

    def problem(
        self, u: Floats, counts: Counts, there: Flags | None = None, temperature: Floats | None = None
    ) -> FitProblem:
        """Return the observations of a record, as for `examine`, and the machine."""
        check_size(u)
        self.steps_before(u.size)
        stretches = tuple(self.observe(u, counts, np.ones(u.size, bool) if there is None else there, temperature))
        if not stretches:
            raise NotIdentifiableError(f"the record has no stretch of samples with input and counts; {MOVE}")
        return FitProblem(machine_of(self.equation), stretches, self.encoder.resolution)

    def position(self, counts: Counts) -> Floats:
        """Return the unwrapped position (n,) of the counts, without the jumps beyond max_speed."""
        y = self.encoder.position(counts)
        if self.encoder.max_speed is None:
            return y
        change = np.diff(y)
        jump = np.abs(change) > self.encoder.max_speed * self.dt + self.encoder.resolution
        return np.asarray(y[0] + np.r_[0.0, np.cumsum(np.where(jump, 0.0, change))])

    def summarise(self, fitted: Fitted) -> Fit:
        """Return the parameters and their covariance. The residual is that of the motion [unit of y]."""
        residual = np.concatenate(fitted.residuals) * self.encoder.resolution
        travel = np.concatenate([one.y - np.mean(one.y) for one in fitted.problem.stretches])
        relative = float(np.linalg.norm(residual) / np.linalg.norm(travel))
        return Fit(self.names, self.units, fitted.theta, fitted.covariance, residual.size, residual, relative, 0)

    def observe(
        self, u: Floats, counts: Counts, there: Flags, temperature: Floats | None = None
    ) -> Iterator[ObservedStretch]:
        """Yield the stretches of a record between gaps of the input, with at least three counts, from the first
        count of the record. The only column is the temperature, if there is one, without its mean."""
        force, position = u * self.equation.input_gain, self.position(counts)
        position = position - position[0]
        intervals = np.broadcast_to(self.intervals, u.shape)
        columns = np.zeros((0, u.size)) if temperature is None else (temperature - np.mean(temperature))[None]
        known = np.isfinite(u)
        edges = np.flatnonzero(np.diff(np.r_[False, known, False].astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():
            row = np.flatnonzero(there[first:last]).astype(np.int32)
            if row.size < 3:
                continue
            part = slice(first, last - 1)
            drive = Excitation(
                np.ascontiguousarray(intervals[part], np.float64),
                np.ascontiguousarray(force[part]),
                row,
                np.ascontiguousarray(columns[:, part]),
            )
            flags = np.ones(row.size, bool)
            yield ObservedStretch(drive, position[first:last][row], np.full(row.size, 1 / 12), flags, ~flags, first)
