"""Methods for whole records, and the check of which parameters a record can identify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.encoder import fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import check_arrays, check_size, integer_counts
from pmfid.estimators.least_squares import level_of, long_run_covariance
from pmfid.estimators.plants import START_PIVOT
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.stretches import parts_of
from pmfid.status import Status
from pmfid.types import Counts, Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: A target that is closer to one regressor alone, or a sensitivity that is closer to the others, relative to its
#: size, identifies no other parameter.
TARGET_APART = 1e-6
#: Largest number whose square stays within the format.
BEYOND = 1e120
#: Part of a column's power that products of columns show accurately. The rounding error is 1e-16 over its square.
PRODUCTS_ACCURATE = 1e-5


def check_identifiable(
    columns: Columns, names: tuple[str, ...], least_part: float = START_PIVOT, simulated: bool = False
) -> None:
    """Raise NotIdentifiableError with a parameter's name if a column is zero or a combination of the other columns.
    With `simulated`, the equation holds only while the simulated motion moves."""
    if columns.z.size <= 2 * len(names) and columns.status & Status.COUNT_JUMP:
        raise NotIdentifiableError(
            "the counts jump in many places: check the wiring and the counter's bits, or correct max_speed"
        )
    if columns.z.size <= 2 * len(names):
        raise NotIdentifiableError(
            f"only {columns.z.size} samples remain after the filters have settled, too few for "
            f"{len(names)} parameters; record longer, or use a higher cutoff"
        )
    parts = (columns.phi, columns.z, columns.zeta)
    if not max(np.max([np.max(part), -np.min(part)]) for part in parts) < BEYOND:
        raise NotIdentifiableError(
            "the measured or the simulated motion exceeds the range of numbers: check the scales of "
            "input and output, and the signs in [model]"
        )
    if not np.any(columns.phi[:, 0]):
        raise NotIdentifiableError(
            "the axis does not move in this record, so nothing can be identified; record a motion"
        )
    if not np.any(columns.z) and simulated:
        raise NotIdentifiableError(
            "the simulated motion stays at rest, because friction or a load exceeds the force of the "
            "input; check input_gain and the model"
        )
    if not np.any(columns.z):
        raise NotIdentifiableError(
            "the input is zero while the axis moves, once the filters have settled: record the input "
            "that drives the axis, from before the motion"
        )
    if _are_apart(columns, least_part):
        return
    _check_target(columns, names)
    for kind, matrix in (("regressor", columns.phi), ("instrument", columns.zeta)):
        _check_rank(kind, matrix, names, least_part)


def _check_target(columns: Columns, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError if friction alone explains the input. Encoder noise would otherwise determine the
    mass.
    """
    for name, column in zip(names, columns.phi.T, strict=True):
        norm = float(np.linalg.norm(column))
        apart = np.linalg.norm(columns.z - column * (columns.z @ column) / max(norm**2, 1 / BEYOND))
        if norm > 0 and apart < TARGET_APART * np.linalg.norm(columns.z):
            raise NotIdentifiableError(
                f"the input is proportional to the regressor of {name} all the time: the excitation is too "
                "poor; record reversals, and an input that changes while the axis moves"
            )


def _check_rank(kind: str, matrix: NDArray[np.float64], names: tuple[str, ...], least_part: float) -> None:
    scale = np.linalg.norm(matrix, axis=0)
    for name, norm in zip(names, scale, strict=True):
        if norm == 0:
            raise NotIdentifiableError(
                f"the {kind} of {name} is always zero: the record contains no information on {name}"
            )
    # the rows of this inverse have the same lengths as those of the matrix's inverse
    inverse = np.linalg.pinv(np.linalg.qr(matrix / scale, mode="r"))
    own = 1 / np.sum(inverse**2, axis=1)  # the part of each column that is no combination of the other columns
    worst = int(np.argmin(own))
    if own[worst] < least_part:
        raise NotIdentifiableError(
            f"the {kind} of {names[worst]} follows from the others up to {np.sqrt(own[worst]):.1g} of its "
            "size: the excitation is too poor; record reversals, and varying speeds and accelerations"
        )


def _are_apart(columns: Columns, least_part: float) -> bool:
    """Return whether products show that the target, the regressors and the instruments are far from each other. A
    decomposition of the columns takes ten times as long, and is needed only if the products are too inaccurate."""
    least, z = max(PRODUCTS_ACCURATE, 2 * least_part), columns.z
    for matrix in (columns.phi, columns.zeta):
        products, along = matrix.T @ matrix, matrix.T @ z
        size = np.sqrt(np.diagonal(products))
        if not np.all(size > 0):
            return False
        try:
            own = 1 / np.diagonal(np.linalg.inv(products / np.outer(size, size)))
        except np.linalg.LinAlgError:
            return False
        alone = 1 - (along / size) ** 2 / (z @ z)  # part of the target's power that the column alone leaves
        if not min(np.min(own), np.min(alone)) > least:
            return False
    return True


def filter_parts(
    kernel: Kernel, u: Floats, counts: Counts, steps: Floats | None = None
) -> tuple[Floats, NDArray[np.uint32]]:
    """Return the columns (n, c) and the status (n,) of a record, u and counts (n,).

    An input that is not a number marks a gap, after which the filters restart. `steps` (n,) is the time before each
    sample [s].
    """
    parts = parts_of(u)
    if len(parts) == 1 and parts[0] == slice(0, u.size):
        return kernel.filter(u, counts, steps)
    filtered = list[tuple[slice, Floats, NDArray[np.uint32]]]()
    for part in parts:
        if filtered:
            kernel.gap(int(counts[part.start]))
        filtered.append((part, *kernel.filter(u[part], counts[part], None if steps is None else steps[part])))
    width = filtered[0][1].shape[1] if filtered else kernel.filter(u[:0], counts[:0], None)[0].shape[1]
    columns, status = np.zeros((u.size, width)), np.full(u.size, int(Status.SETTLING), np.uint32)
    for part, rows, bits in filtered:
        columns[part], status[part] = rows, bits
    return columns, status


@dataclass(frozen=True)
class BatchEstimator(Estimator):
    """An `Estimator` for whole records."""

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        """Return a recursion without parameters. The kernel only filters, and holds more columns than it could
        estimate.
        """
        return super().recursion_config(0, instrumental, forgetting, first_column)

    def columns(self, u: ArrayLike, counts: ArrayLike) -> Columns:
        """Return regressors, target and instruments of all samples after the filters have settled; u, counts: (n,)."""
        u, counts = check_arrays(u, counts)
        check_size(u)
        columns, status = filter_parts(self.make_kernel(), u, counts, self.steps_before(u.size))
        used = (status & Status.SETTLING) == 0
        columns, p = columns[used], len(self.names)
        zeta = columns[:, p + 1 :] if self.instrumental else columns[:, :p]
        occurred = int(np.bitwise_or.reduce(status)) & ~int(Status.SETTLING | Status.STARTING)
        return Columns(columns[:, :p], columns[:, p], zeta, used, occurred)

    @property
    def least_part(self) -> float:
        """Least part of a column's power that must not follow from the other columns."""
        return self.plant.least_part

    def fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimate the parameters from u, counts: (n,).

        Raises UsageError if the arrays do not match. Raises NotIdentifiableError with a parameter and the reason if the
        record cannot identify every parameter.

        A process with a constant is filtered from its first output on. Far from zero, the filters would otherwise
        remember their start at zero for a long time. The estimate of the constant holds for the output itself.
        """
        first = self._first_count(counts)
        if first == 0:
            return self._fit(u, counts)
        return self._restore_first_output(self._fit(u, integer_counts(counts) - first), first * self.encoder.resolution)

    def _first_count(self, counts: ArrayLike) -> int:
        """Return the first count with its sign if the equation holds for the change since the first count, or else
        0.
        """
        if level_of(self.equation) is None:
            return 0
        given = integer_counts(counts)
        half = 2 ** (self.encoder.bits - 1)
        return (int(given[0]) + half) % (2 * half) - half if given.ndim == 1 and given.size else 0

    def _restore_first_output(self, fit: Fit, first: float) -> Fit:
        """Return the fit of y - first as a fit of y. The constant of y contains A(0) first."""
        level, lift = level_of(self.equation), np.eye(len(fit.theta))
        if level is not None and level.lowest is not None:
            lift[level.constant, level.lowest] = level.ratio * first
        return replace(fit, theta=lift @ fit.theta, theta_cov=lift @ fit.theta_cov @ lift.T)

    def solve(self, u: ArrayLike, counts: ArrayLike) -> NDArray[np.float64]:
        """Return theta (p,) of `fit` with matched filters, without error bars. Raises the errors of `fit`."""
        return self._solve_columns(u, counts)[1]

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        columns, theta, gain = self._solve_columns(u, counts)
        return self._result(columns, theta, self._covariance(columns, theta, gain))

    def _solve_columns(
        self, u: ArrayLike, counts: ArrayLike
    ) -> tuple[Columns, NDArray[np.float64], NDArray[np.float64]]:
        columns = self.columns(u, counts)
        check_identifiable(columns, self.names, self.least_part)
        return columns, *self._solve(columns)

    def fit_output(self, u: ArrayLike, y: ArrayLike) -> Fit:
        """Estimate the parameters from an output (n,) that is a measured number, without encoder counts. The resolution
        of the encoder is not used. Raises the same errors as `fit`."""
        y = np.asarray(y, np.float64)
        if not np.all(np.isfinite(y)) or y.ndim != 1:
            raise UsageError(f"y must be a finite array (n,), got shape {y.shape}; see Experiment for missing samples")
        encoder, counts = fine_counts(y)
        return replace(self, encoder=encoder).fit(u, counts)

    def _result(self, columns: Columns, theta: NDArray[np.float64], covariance: NDArray[np.float64]) -> Fit:
        residual = columns.z - columns.phi @ theta
        relative = float(np.linalg.norm(residual) / np.linalg.norm(columns.z))
        return Fit(
            self.names,
            self.units,
            theta,
            covariance,
            residual.size,
            residual,
            relative,
            columns.status,
        )

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return theta (p,) and the gain (p, p) = (sum zeta phi^T)^-1, by which a change of sum zeta z moves theta."""
        raise NotImplementedError

    def _covariance(
        self, columns: Columns, theta: NDArray[np.float64], gain: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariance (p, p) of theta (p,) from the scatter of the scores over the memory of the filters (the
        sandwich of Newey and West 1987)."""
        n = columns.z.size
        spread = long_run_covariance(self._scores(columns, theta), self.settle_samples)
        return np.asarray(gain @ spread @ gain.T * n / max(1, n - theta.size))

    def _scores(self, columns: Columns, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pull (n, p) of each sample on theta before the gain. The sum over all samples is zero."""
        return np.asarray(columns.zeta * (columns.z - columns.phi @ theta)[:, None])
