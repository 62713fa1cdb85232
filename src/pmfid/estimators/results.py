"""Results of estimators: the fit of a record, and the track over a record's samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import bars
from pmfid.errors import place_of
from pmfid.presentation import Parameters, Presentable, PresentableParameters, Summary, plain, remarks_of
from pmfid.status import Status, status_names


@dataclass(frozen=True, repr=False)
class Fit(PresentableParameters):
    """Result of an off-line estimate with p parameters from n used samples.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the p parameters.
    theta : ndarray (p,)
        Parameters; `fit["mass"]` returns one of them.
    theta_cov : ndarray (p, p)
        Covariance of the parameters for coloured residuals (Newey and West 1987).
    samples : int
        Number of used samples n.
    residual : ndarray (n,)
        Residual z - phi^T theta.
    relative_error : float
        Norm of the residual over the norm of the target.
    status : int
        All `Status` bits that occurred.
    notes : tuple of str
        Choices that the method made by itself.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Fit
    >>> fit = Fit(("mass",), ("kg",), np.array([1.07]), np.array([[1e-4]]), 100, np.zeros(100), 0.0, 0)
    >>> fit["mass"], fit.theta_std
    (1.07, array([0.01]))
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: NDArray[np.float64]
    theta_cov: NDArray[np.float64]
    samples: int
    residual: NDArray[np.float64]
    relative_error: float
    status: int
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def theta_std(self) -> NDArray[np.float64]:
        """Standard deviations (p,). An entry is NaN if rounding leaves no positive variance."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.diagonal(self.theta_cov)))

    def summary(self) -> Summary:
        title = f"fit of {self.samples} samples, relative error {100 * self.relative_error:.3g} %"
        return self._parameters.summary(title, remarks_of(status_names(self.status), self.notes))

    def to_dict(self) -> dict[str, object]:
        """Return the result as a dict, without the residual."""
        return {
            "samples": self.samples,
            "parameters": self._parameters.content,
            "relative_error": plain(self.relative_error),
            "status": status_names(self.status),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Columns:
    """Filtered columns phi (n, p), z (n,), zeta (n, p) of the n samples in use, and the status bits that occurred.
    `used` (N,) marks the samples in use within the whole record."""

    phi: NDArray[np.float64]
    z: NDArray[np.float64]
    zeta: NDArray[np.float64]
    used: NDArray[np.bool_]
    status: int


@dataclass(frozen=True, repr=False)
class Track(Presentable):
    """Estimates over a record of n samples with p parameters.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the p parameters.
    theta : ndarray (n, p)
        Parameters; `track["mass"]` returns one of them (n,).
    variance_factor : ndarray (n, p)
        Diagonal of P.
    inflation : ndarray (n, p)
        Factor by which coloured innovations raise the variances; 0 while unknown.
    innovation : ndarray (n,)
        A priori error [unit of the target].
    innovation_variance : ndarray (n,)
    status : ndarray of uint32 (n,)
        `Status` bits.

    Examples
    --------
    >>> from pmfid import RLS, Drive, Encoder, Status
    >>> track = RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0).run([0.0] * 5, [0] * 5)
    >>> track.theta.shape
    (5, 3)
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: NDArray[np.float64]
    variance_factor: NDArray[np.float64]
    inflation: NDArray[np.float64]
    innovation: NDArray[np.float64]
    innovation_variance: NDArray[np.float64]
    status: NDArray[np.uint32]

    @cached_property
    def theta_std(self) -> NDArray[np.float64]:
        """Standard deviations (n, p), infinite before the first estimate and scaled by the inflation once known."""
        return bars(*map(np.ascontiguousarray, (self.variance_factor, self.innovation_variance, self.inflation)))

    def with_bars(
        self,
        names: tuple[str, ...],
        units: tuple[str, ...],
        theta: NDArray[np.float64],
        std: NDArray[np.float64],
    ) -> Track:
        """Return a track of the same samples with other parameters theta (n, q) and standard deviations (n, q)."""
        variance = np.where(self.innovation_variance > 0, self.innovation_variance, np.inf)
        factor = np.where(np.isfinite(std), std, 0.0) ** 2 / variance[:, None]
        whole = np.where(np.all(np.isfinite(std), axis=1), self.innovation_variance, 0.0)
        inflation = np.zeros_like(theta)
        return Track(names, units, theta, factor, inflation, self.innovation, whole, self.status)

    def repeat_last(self, samples: int, status: Status) -> Track:
        """Return a track that repeats the last estimate for further samples and adds a status bit."""
        own = {name: np.repeat(getattr(self, name)[-1:], samples, axis=0) for name in _signals()}
        own["innovation"][:] = 0.0
        own["status"] |= np.uint32(status)
        return Track(self.names, self.units, **own)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the track (n,) of one parameter. Raises UnknownParameterError, a KeyError that lists the names."""
        return self.theta[..., place_of(name, self.names)]

    def has_status(self, bit: Status) -> NDArray[np.bool_]:
        """Return a mask (n,) of the samples that have a status bit."""
        return np.asarray((self.status & bit) != 0)

    def summary(self) -> Summary:
        """Return the summary of the last estimate."""
        if not self.status.size:
            return Summary("track without samples", Parameters.header, [])
        last = Parameters(self.names, self.units, self.theta[-1], self.theta_std[-1])
        title = f"track of {self.status.size} samples; the last estimate:"
        return last.summary(title, remarks_of(status_names(int(self.status[-1]))))

    def columns(self) -> dict[str, object]:
        """Table of parameters, standard deviations, innovation and status, with a row for each sample from 0 on."""
        found: dict[str, object] = {"sample": np.arange(self.status.size)}
        for i, name in enumerate(self.names):
            found |= {name: self.theta[:, i], f"{name}_std": self.theta_std[:, i]}
        return found | {"innovation": self.innovation, "status": self.status}

    def to_dict(self) -> dict[str, object]:
        """Return a dict with lists over the samples."""
        return {
            "samples": int(self.status.size),
            "units": dict(zip(self.names, self.units, strict=True)),
            **{name: plain(values) for name, values in self.columns().items()},
        }


def _signals() -> list[str]:
    """Return the names of all arrays that a track has over the samples."""
    return [field.name for field in fields(Track) if field.name not in ("names", "units")]


def join_tracks(parts: Sequence[Track]) -> Track:
    """Return one track from consecutive parts."""
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _signals()}
    return Track(parts[0].names, parts[0].units, **whole)


@dataclass(frozen=True, repr=False)
class Tracks(Track):
    """Estimates of many axes, as a `Track` whose arrays have the axis as first dimension.

    Attributes
    ----------
    theta, variance_factor, inflation : ndarray (axes, m, p)
        m is the number of kept samples. `tracks["mass"]` is (axes, m).
    innovation, innovation_variance, status : ndarray (axes, m)
    samples : ndarray (m,)
        Numbers of the kept samples.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RLS, Drive, Encoder, Fleet
    >>> fleet = Fleet(RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0), axes=3)
    >>> tracks = fleet.run(np.zeros((3, 10)), np.zeros((3, 10), int), every=5)
    >>> tracks.samples, tracks.theta.shape
    (array([4, 9]), (3, 2, 3))
    """

    samples: NDArray[np.int64]

    def axis(self, index: int) -> Track:
        """Return the track of one axis."""
        return Track(self.names, self.units, **{name: getattr(self, name)[index] for name in _signals()})

    def summary(self) -> Summary:
        """Return the summary of the last estimates, with the median and the central 90 % over the axes."""
        axes, kept = self.status.shape
        title = f"tracks of {axes} axes, {kept} sample{'s' * (kept != 1)} kept; the last estimates:"
        header = ("parameter", "median", "5 %", "95 %", "unit")
        rows = [
            (name, *self._quantiles(i), unit) for i, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        ]
        lines = [f"{name} {middle} {unit}, {low} to {high}" for name, middle, low, high, unit in rows]
        status = int(np.bitwise_or.reduce(self.status[:, -1])) if self.status.size else 0
        remarks = [f"of some axes {remark}" for remark in remarks_of(status_names(status))]
        return Summary(title, header, rows, lines, remarks)

    def _quantiles(self, i: int) -> list[str]:
        last = self.theta[:, -1, i] if self.status.size else np.full(1, np.nan)
        return [f"{value:.6g}" for value in np.quantile(last, (0.5, 0.05, 0.95))]

    def columns(self) -> dict[str, object]:
        """Table with a row for each sample of each axis."""
        axes, kept = self.status.shape
        found: dict[str, object] = {"axis": np.repeat(np.arange(axes), kept), "sample": np.tile(self.samples, axes)}
        for i, name in enumerate(self.names):
            found |= {name: self.theta[..., i].ravel(), f"{name}_std": self.theta_std[..., i].ravel()}
        return found | {"innovation": self.innovation.ravel(), "status": self.status.ravel()}
