"""What a recursive estimator says over a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import place_of
from pmfid.status import Status


@dataclass(frozen=True)
class Track:
    """Estimates over a record of n samples with p parameters.

    theta: (n, p); innovation: (n,) a priori error in the unit of the target; innovation_variance: (n,);
    variance_factor: (n, p), the diagonal of P; inflation: (n, p), what coloured innovations make of the variances,
    0 while not known; status: (n,) `Status` bits; names, units: of the p parameters.
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
        """(n, p) standard deviations, infinite until there is an estimate; scaled by the inflation once it is known."""
        known = self.innovation_variance > 0
        scale = np.where(self.inflation[known] > 0, self.inflation[known], 1.0)
        std = np.full_like(self.theta, np.inf)
        with np.errstate(over="ignore"):  # infinite is right where nothing is known
            std[known] = np.sqrt(self.variance_factor[known] * self.innovation_variance[known, None] * scale)
        return std

    def with_bars(
        self,
        names: tuple[str, ...],
        units: tuple[str, ...],
        theta: NDArray[np.float64],
        std: NDArray[np.float64],
    ) -> Track:
        """The same samples with other parameters theta (n, q) and their standard deviations (n, q)."""
        variance = np.where(self.innovation_variance > 0, self.innovation_variance, np.inf)
        factor = np.where(np.isfinite(std), std, 0.0) ** 2 / variance[:, None]
        whole = np.where(np.all(np.isfinite(std), axis=1), self.innovation_variance, 0.0)
        inflation = np.zeros_like(theta)
        return Track(names, units, theta, factor, inflation, self.innovation, whole, self.status)

    def held(self, samples: int, status: Status) -> Track:
        """So many samples of the last estimate, with a status bit."""
        own = {name: np.repeat(getattr(self, name)[-1:], samples, axis=0) for name in _signals()}
        own["innovation"][:] = 0.0
        own["status"] |= np.uint32(status)
        return Track(self.names, self.units, **own)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The (n,) track of one parameter. Raises UnknownParameterError, a KeyError, listing the names."""
        return self.theta[..., place_of(name, self.names)]

    def flagged(self, bit: Status) -> NDArray[np.bool_]:
        """(n,) where a status bit is set."""
        return np.asarray((self.status & bit) != 0)


def _signals() -> list[str]:
    """What a track has of every sample, by name."""
    return [field.name for field in fields(Track) if field.name not in ("names", "units")]


def joined(parts: Sequence[Track]) -> Track:
    """One track of pieces that follow each other."""
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _signals()}
    return Track(parts[0].names, parts[0].units, **whole)


@dataclass(frozen=True)
class Tracks(Track):
    """Estimates of many axes: a `Track` whose arrays have the axis in front.

    theta, variance_factor, inflation: (axes, m, p); innovation, innovation_variance, status: (axes, m), where m is the
    number of samples that were kept; samples: (m,) their numbers. `tracks["mass"]` is (axes, m).
    """

    samples: NDArray[np.int64]

    def axis(self, index: int) -> Track:
        """The track of one axis."""
        return Track(
            self.names,
            self.units,
            self.theta[index],
            self.variance_factor[index],
            self.inflation[index],
            self.innovation[index],
            self.innovation_variance[index],
            self.status[index],
        )
