"""What off-line estimates are made of and what they give: filtered columns and a fit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import place_of
from pmfid.presentation import Parameters, Presentable, Summary, plain, remarks_of
from pmfid.status import status_names


@dataclass(frozen=True, repr=False)
class Fit(Presentable):
    """Result of an off-line estimate with p parameters from n used samples.

    theta: (p,); theta_cov: (p, p), for coloured residuals (Newey and West 1987); names, units; samples: n;
    residual: (n,) z - phi^T theta;
    relative_error: norm of the residual over norm of the target; status: all `Status` bits that occurred; notes: what
    the method chose by itself, for people.
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
        """(p,) standard deviations; NaN where rounding leaves no variance."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.diagonal(self.theta_cov)))

    def __getitem__(self, name: str) -> float:
        """One parameter. Raises UnknownParameterError, a KeyError, listing the names."""
        return float(self.theta[place_of(name, self.names)])

    @property
    def _parameters(self) -> Parameters:
        return Parameters(self.names, self.units, self.theta, self.theta_std)

    def summary(self) -> Summary:
        title = f"fit of {self.samples} samples, relative error {100 * self.relative_error:.3g} %"
        return self._parameters.summary(title, remarks_of(status_names(self.status), self.notes))

    def columns(self) -> dict[str, object]:
        """A row for each parameter."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        """Without the residual."""
        return {
            "samples": self.samples,
            "parameters": self._parameters.content,
            "relative_error": plain(self.relative_error),
            "status": status_names(self.status),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Columns:
    """Filtered columns of the n samples in use: phi (n, p), z (n,), zeta (n, p); used (N,) of the whole record; the
    status bits that occurred."""

    phi: NDArray[np.float64]
    z: NDArray[np.float64]
    zeta: NDArray[np.float64]
    used: NDArray[np.bool_]
    status: int
