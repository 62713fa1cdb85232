"""Methods on whole records, and what a record can identify."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.encoder import fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import check_arrays, check_size, integer_counts
from pmfid.estimators.least_squares import level_of, long_run_covariance
from pmfid.estimators.results import Columns, Fit
from pmfid.estimators.tuning import TUNING
from pmfid.status import Status


def check_identifiable(
    columns: Columns, names: tuple[str, ...], least_part: float = TUNING.start_pivot, simulated: bool = False
) -> None:
    """Raises NotIdentifiableError if a column is zero or a combination of the others, naming the parameter.
    simulated: the equation holds while a simulated motion moves, and says nothing while that rests."""
    if columns.z.size <= 2 * len(names) and columns.status & Status.COUNT_JUMP:
        raise NotIdentifiableError(
            "the counts jump all the time: check the wiring and the counter's bits, or correct max_speed"
        )
    if columns.z.size <= 2 * len(names):
        raise NotIdentifiableError(
            f"only {columns.z.size} samples are left after the filters have settled, too few for {len(names)} "
            "parameters; record longer, or use a higher cutoff"
        )
    parts = (columns.phi, columns.z, columns.zeta)
    if not max(np.max([np.max(part), -np.min(part)]) for part in parts) < TUNING.batch_beyond:
        raise NotIdentifiableError(
            "the motion, or the one simulated, leaves the range of numbers: check the scales of input and output, and "
            "the signs in [model]"
        )
    if not np.any(columns.phi[:, 0]):
        raise NotIdentifiableError("the axis does not move in this record: nothing can be identified; record a motion")
    if not np.any(columns.z) and simulated:
        raise NotIdentifiableError(
            "the simulated motion rests throughout, held by friction or a load above what the input can move: check "
            "input_gain and the model"
        )
    if not np.any(columns.z):
        raise NotIdentifiableError(
            "after the filters have settled the input is zero while the axis moves: record the input that drives it, "
            "from before the motion on"
        )
    if _are_apart(columns, least_part):
        return
    _check_target(columns, names)
    for kind, matrix in (("regressor", columns.phi), ("instrument", columns.zeta)):
        _check_rank(kind, matrix, names, least_part)


def _check_target(columns: Columns, names: tuple[str, ...]) -> None:
    """An input that is explained by friction alone says nothing of the mass: encoder noise would decide."""
    for name, column in zip(names, columns.phi.T, strict=True):
        norm = float(np.linalg.norm(column))
        apart = np.linalg.norm(columns.z - column * (columns.z @ column) / max(norm**2, TUNING.tiny))
        if norm > 0 and apart < TUNING.target_apart * np.linalg.norm(columns.z):
            raise NotIdentifiableError(
                f"the input is proportional to the regressor of {name} throughout: too little excitation; record "
                "reversals, and an input that changes while the axis moves"
            )


def _check_rank(kind: str, matrix: NDArray[np.float64], names: tuple[str, ...], least_part: float) -> None:
    scale = np.linalg.norm(matrix, axis=0)
    for name, norm in zip(names, scale, strict=True):
        if norm == 0:
            raise NotIdentifiableError(f"the {kind} of {name} is zero throughout: the record says nothing about it")
    inverse = np.linalg.pinv(np.linalg.qr(matrix / scale, mode="r"))  # its rows are as long as those for the matrix
    own = 1 / np.sum(inverse**2, axis=1)  # what of a column is not a combination of the others
    worst = int(np.argmin(own))
    if own[worst] < least_part:
        raise NotIdentifiableError(
            f"the {kind} of {names[worst]} follows from the others to {np.sqrt(own[worst]):.1g} of its size: too "
            "little excitation; record reversals, and speeds and accelerations that vary"
        )


def _are_apart(columns: Columns, least_part: float) -> bool:
    """Are the target, the regressors and the instruments far from each other by their products? A decomposition of the
    columns takes ten times as long, and is needed only where the products are not accurate enough."""
    least, z = max(TUNING.products_accurate, 2 * least_part), columns.z
    for matrix in (columns.phi, columns.zeta):
        products, along = matrix.T @ matrix, matrix.T @ z
        size = np.sqrt(np.diagonal(products))
        if not np.all(size > 0):
            return False
        try:
            own = 1 / np.diagonal(np.linalg.inv(products / np.outer(size, size)))
        except np.linalg.LinAlgError:
            return False
        alone = 1 - (along / size) ** 2 / (z @ z)  # of the power of the target, beyond one column
        if not min(np.min(own), np.min(alone)) > least:
            return False
    return True


@dataclass(frozen=True)
class BatchEstimator(Estimator):
    """An `Estimator` over a whole record."""

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        """None: the kernel filters, and holds columns of more parameters than it could estimate."""
        return super().recursion_config(0, instrumental, forgetting, first_column)

    def columns(self, u: ArrayLike, counts: ArrayLike) -> Columns:
        """Regressors, target and instruments of the samples after the filters have settled; u, counts: (n,)."""
        u, counts = check_arrays(u, counts)
        check_size(u)
        columns, status = self.make_kernel().filter(u, counts, self.steps_before(u.size))
        used = (status & Status.SETTLING) == 0
        columns, p = columns[used], len(self.names)
        zeta = columns[:, p + 1 :] if self.instrumental else columns[:, :p]
        occurred = int(np.bitwise_or.reduce(status)) & ~int(Status.SETTLING | Status.STARTING)
        return Columns(columns[:, :p], columns[:, p], zeta, used, occurred)

    @property
    def least_part(self) -> float:
        """The least part of a column's power that must not follow from the others."""
        return self.plant.least_part

    def fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimates from u, counts: (n,). Raises UsageError for arrays that do not fit each other and
        NotIdentifiableError where the record cannot identify every parameter, naming the one and the reason.

        A process with a constant is filtered from its first output on: far from zero the filters would remember for
        long that they began there. The constant is given for the output itself.
        """
        first = self._first_count(counts)
        if first == 0:
            return self._fit(u, counts)
        return self._restore_first_output(self._fit(u, integer_counts(counts) - first), first * self.encoder.resolution)

    def _first_count(self, counts: ArrayLike) -> int:
        """The first count, with its sign, where the equation is as true of what was counted since; else 0."""
        if level_of(self.equation) is None:
            return 0
        given = integer_counts(counts)
        half = 2 ** (self.encoder.bits - 1)
        return (int(given[0]) + half) % (2 * half) - half if given.ndim == 1 and given.size else 0

    def _restore_first_output(self, fit: Fit, first: float) -> Fit:
        """The fit of y - first in the parameters of y: A(0) first is part of the constant."""
        level, lift = level_of(self.equation), np.eye(len(fit.theta))
        if level is not None and level.lowest is not None:
            lift[level.constant, level.lowest] = level.ratio * first
        return replace(fit, theta=lift @ fit.theta, theta_cov=lift @ fit.theta_cov @ lift.T)

    def solve(self, u: ArrayLike, counts: ArrayLike) -> NDArray[np.float64]:
        """theta (p,) of `fit` with matched filters, without its error bars; raises as `fit`."""
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
        """Estimates from an output (n,) that is measured as a number; no encoder counts, and its resolution is not
        used. Raises as `fit`."""
        y = np.asarray(y, np.float64)
        if not np.all(np.isfinite(y)) or y.ndim != 1:
            raise UsageError(f"y must be a finite array (n,), got shape {y.shape}; see Experiment for missing samples")
        return self._fit_output(u, y)

    def _fit_output(self, u: ArrayLike, y: NDArray[np.float64]) -> Fit:
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
        """theta (p,) and the gain (p, p) by which a change of sum zeta z moves it: (sum zeta phi^T)^-1."""
        raise NotImplementedError

    def _covariance(
        self, columns: Columns, theta: NDArray[np.float64], gain: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        n = columns.z.size
        spread = long_run_covariance(self._scores(columns, theta), self.settle_samples)
        return np.asarray(gain @ spread @ gain.T * n / max(1, n - theta.size))

    def _scores(self, columns: Columns, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, p): what each sample says that theta be moved by, before the gain; zero in the sum."""
        return np.asarray(columns.zeta * (columns.z - columns.phi @ theta)[:, None])
