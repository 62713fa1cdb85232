"""Off-line estimators: the whole record at once, on the kernel's columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.encoder import fine_counts
from pmfid.errors import NotIdentifiableError, UsageError, place_of
from pmfid.estimators.base import EXACT, START_PIVOT, Estimator, check_arrays, check_size, integer_counts
from pmfid.status import Status

#: A target closer than this to one regressor alone, relative to its size, identifies nothing else.
TARGET_APART = 1e-6
TINY = 1e-300
NO_SOLUTION = (
    "the equations for the parameters have no one solution: too little excitation; record reversals, and speeds and "
    "accelerations that vary"
)
#: The square of a number must not leave the format.
BEYOND = 1e120
#: Of the power of a column that must not follow from the others, of a linear process: its derivatives nearly do, around
#: each lightly damped mode.
PROCESS_PART = 1e-12


@dataclass(frozen=True)
class Fit:
    """Result of an off-line estimate with p parameters from n used samples.

    theta: (p,); theta_cov: (p, p), for coloured residuals (Newey and West 1987); names, units; samples: n;
    residual: (n,) z - phi^T theta;
    relative_error: norm of the residual over norm of the target; status: all `Status` bits that occurred.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: NDArray[np.float64]
    theta_cov: NDArray[np.float64]
    samples: int
    residual: NDArray[np.float64]
    relative_error: float
    status: int

    @property
    def theta_std(self) -> NDArray[np.float64]:
        """(p,) standard deviations; NaN where rounding leaves no variance."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.diagonal(self.theta_cov)))

    def __getitem__(self, name: str) -> float:
        """One parameter. Raises UnknownParameterError, a KeyError, listing the names."""
        return float(self.theta[place_of(name, self.names)])


@dataclass(frozen=True)
class Columns:
    """Filtered columns of the n samples in use: phi (n, p), z (n,), zeta (n, p); used (N,) of the whole record; the
    status bits that occurred."""

    phi: NDArray[np.float64]
    z: NDArray[np.float64]
    zeta: NDArray[np.float64]
    used: NDArray[np.bool_]
    status: int


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
        columns, status = self.make_kernel().filter(u, counts)
        used = (status & Status.SETTLING) == 0
        columns, p = columns[used], len(self.names)
        zeta = columns[:, p + 1 :] if self.instrumental else columns[:, :p]
        occurred = int(np.bitwise_or.reduce(status)) & ~int(Status.SETTLING | Status.STARTING)
        return Columns(columns[:, :p], columns[:, p], zeta, used, occurred)

    @property
    def least_part(self) -> float:
        """Of the power of a column that must not follow from the others."""
        return PROCESS_PART if self.equation.process else START_PIVOT

    def fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Estimates from u, counts: (n,). Raises UsageError for arrays that do not fit each other and
        NotIdentifiableError where the record cannot identify every parameter, naming the one and the reason.

        A process with a constant is filtered from its first output on: far from zero the filters would remember for
        long that they began there. The constant is given for the output itself.
        """
        first = self._first_count(counts)
        if first == 0:
            return self._fit(u, counts)
        return self._lifted(self._fit(u, integer_counts(counts) - first), first * self.encoder.resolution)

    def _first_count(self, counts: ArrayLike) -> int:
        """The first count, with its sign, where the equation is as true of what was counted since; else 0."""
        signals = {term.signal for term in self.equation.unknown}
        known = {term.signal for term in self.equation.known}
        if not {"constant", "process_output"} <= signals or "start" in signals or "constant" in known:
            return 0
        given = integer_counts(counts)
        half = 2 ** (self.encoder.bits - 1)
        return (int(given[0]) + half) % (2 * half) - half if given.ndim == 1 and given.size else 0

    def _lifted(self, fit: Fit, first: float) -> Fit:
        """The fit of y - first in the parameters of y: A(0) first is part of the constant."""
        kinds = [(term.signal, term.derivative) for term in self.equation.unknown]
        lift = np.eye(len(kinds))
        if ("process_output", 0) in kinds:
            lowest, constant = (
                self.equation.unknown[kinds.index((kind, 0))] for kind in ("process_output", "constant")
            )
            ratio = -lowest.coefficient / constant.coefficient
            lift[kinds.index(("constant", 0)), kinds.index(("process_output", 0))] = ratio * first
        return replace(fit, theta=lift @ fit.theta, theta_cov=lift @ fit.theta_cov @ lift.T)

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        columns = self.columns(u, counts)
        check_identifiable(columns, self.names, self.least_part)
        if self.discretization == EXACT:
            from pmfid.estimators.exact import fit_exactly

            u, counts = check_arrays(u, counts)
            return fit_exactly(self, u, self.encoder.position(counts))
        theta, gain = self._solve(columns)
        return self._result(columns, theta, self._covariance(columns, theta, gain))

    def fit_output(self, u: ArrayLike, y: ArrayLike) -> Fit:
        """Estimates from an output (n,) that is measured as a number; no encoder counts, and its resolution is not
        used. Raises as `fit`."""
        y = np.asarray(y, np.float64)
        if not np.all(np.isfinite(y)) or y.ndim != 1:
            raise UsageError(f"y must be a finite array (n,), got shape {y.shape}; see Experiment for missing samples")
        if self.discretization == EXACT:
            from pmfid.estimators.exact import fit_exactly

            u, _ = check_arrays(u, np.zeros(y.shape, np.int64))
            return fit_exactly(self, u, y)
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


@dataclass(frozen=True)
class LS(BatchEstimator):
    """Least squares (paper eq. 17): theta = (sum phi phi^T)^-1 sum phi z, by orthogonal decomposition.

    With `prefilter_zeros`: the biased estimate of the extended model (paper eq. 19 to 21).
    """

    method: ClassVar[str] = "ls"
    plain: ClassVar[bool] = True
    exact: ClassVar[bool] = True

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        Q, R = np.linalg.qr(columns.phi / scale)
        inverse = inverse_of(R)
        return inverse @ (Q.T @ columns.z) / scale, inverse @ inverse.T / np.outer(scale, scale)


@dataclass(frozen=True)
class BCLS(BatchEstimator):
    """Bias-compensated least squares (paper eq. 17 to 32): theta = (sum zeta phi^T)^-1 sum zeta z; see `BCRLS`."""

    method: ClassVar[str] = "bcls"
    instrumental: ClassVar[bool] = True
    exact: ClassVar[bool] = True

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return solve_with_instruments(columns)


def solve_with_instruments(columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """theta = (sum zeta phi^T)^-1 sum zeta z (p,), and that inverse (p, p).

    By the orthogonal part of the instruments: the square of their condition number does not enter.
    """
    scale = np.linalg.norm(columns.zeta, axis=0)
    Q, R = np.linalg.qr(columns.zeta / scale)
    inverse = inverse_of(Q.T @ columns.phi)
    with np.errstate(all="ignore"):  # what comes of it is looked at
        theta, gain = inverse @ (Q.T @ columns.z), inverse @ inverse_of(R.T) / scale
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(gain))):
        raise NotIdentifiableError(NO_SOLUTION)
    return theta, gain


def inverse_of(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a matrix (p, p). Raises NotIdentifiableError where there is none, or none within the numbers."""
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at
            inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise NotIdentifiableError(NO_SOLUTION)
    return np.asarray(inverse)


def long_run_covariance(scores: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """Covariance (p, p) of the sum of correlated scores (n, p), with Bartlett's window (Newey and West 1987)."""
    n = scores.shape[0]
    size = 2 ** int(np.ceil(np.log2(n + lags + 1)))
    spectrum = np.fft.rfft(scores, size, axis=0)
    window = np.maximum(0.0, 1 - np.arange(lags + 1) / (lags + 1))
    lagged = np.fft.irfft(spectrum[:, :, None] * spectrum.conj()[:, None, :], size, axis=0)[: min(lags + 1, n)]
    total = np.tensordot(window[: lagged.shape[0]], lagged, axes=1)
    covariance = np.asarray(total + total.T - lagged[0])
    return np.asarray((covariance + covariance.T) / 2)


def parts_of_their_own(
    sensitivity: NDArray[np.float64], rcond: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Which part of each column of sensitivity (n, p), 0 to 1, is no combination of the others, (p,), 0 for a column of
    zeros; and the pseudo-inverse (p, n) of the columns scaled to unit length. rcond: as for `numpy.linalg.pinv`."""
    size = np.linalg.norm(sensitivity, axis=0)
    scaled = sensitivity / np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(scaled) if rcond is None else np.linalg.pinv(scaled, rcond=rcond)
    parts = 1 / np.maximum(np.linalg.norm(inverse, axis=1), 1.0)
    parts[size == 0] = 0.0
    return np.asarray(parts), np.asarray(inverse)


def check_identifiable(
    columns: Columns, names: tuple[str, ...], least_part: float = START_PIVOT, simulated: bool = False
) -> None:
    """Raises NotIdentifiableError where a column is zero or a combination of the others, naming the parameter.
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
    if not max(np.max(np.abs(part)) for part in (columns.phi, columns.z, columns.zeta)) < BEYOND:
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
    _check_target(columns, names)
    for kind, matrix in (("regressor", columns.phi), ("instrument", columns.zeta)):
        _check_rank(kind, matrix, names, least_part)


def _check_target(columns: Columns, names: tuple[str, ...]) -> None:
    """An input that is explained by friction alone says nothing of the mass: encoder noise would decide."""
    for name, column in zip(names, columns.phi.T, strict=True):
        norm = float(np.linalg.norm(column))
        apart = np.linalg.norm(columns.z - column * (columns.z @ column) / max(norm**2, TINY))
        if norm > 0 and apart < TARGET_APART * np.linalg.norm(columns.z):
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
