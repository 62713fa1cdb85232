"""Least squares with compensation of the noise that the known encoder step causes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.least_squares import inverse_of
from pmfid.estimators.recursive import RecursiveEstimator, noise_covariance
from pmfid.estimators.results import Columns


@dataclass(frozen=True)
class KnownStep(BatchEstimator):
    """Off-line least squares with compensation of a known noise variance.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    noise_std : float, optional
        Standard deviation of the position's noise [unit of y]. By default it follows from the encoder's step.

    Notes
    -----
    theta = (R - n sigma^2 C)^-1 (r - n sigma^2 c), with R = sum phi phi^T and r = sum phi z. C and c are the
    covariances of phi and z for noise of variance 1. C and c follow from the filters alone. No instruments and no
    pre-filter are needed. The method fails for coloured noise. Quantisation is coloured below about one count of motion
    per sample.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, KnownStep, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = KnownStep(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(2)
    array([ 1.07, 12.79,  0.81])
    """

    method: ClassVar[str] = "known-step"
    takes_steps: ClassVar[bool] = False

    noise_std: float | None = field(default=None, kw_only=True)

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        noise = columns.z.size * noise_covariance(self, self.noise_std)
        phi = columns.phi / scale
        inverse = inverse_of(phi.T @ phi - noise[:-1, :-1] / np.outer(scale, scale))
        right = phi.T @ columns.z - noise[:-1, -1] / scale
        return inverse @ right / scale, inverse / np.outer(scale, scale)

    def _scores(self, columns: Columns, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        noise = noise_covariance(self, self.noise_std)
        return super()._scores(columns, theta) + noise[:-1, :-1] @ theta - noise[:-1, -1]


@dataclass(frozen=True)
class RKnownStep(RecursiveEstimator):
    """Recursive least squares with compensation of a known noise variance.

    The method discounts the sums of `KnownStep`.

    Parameters
    ----------
    model, encoder, dt, cutoff, forgetting
        See `RIV`.
    noise_std : float, optional
        Standard deviation of the position's noise [unit of y]. By default it follows from the encoder's step.

    Examples
    --------
    >>> from pmfid import Drive, Encoder, RKnownStep
    >>> RKnownStep(Drive(1.0), Encoder(1e-5), 0.001, 50.0, forgetting=0.999).names
    ('mass', 'viscous_friction', 'coulomb_friction')
    """

    method: ClassVar[str] = "rknown-step"
    takes_steps: ClassVar[bool] = False

    noise_std: float | None = field(default=None, kw_only=True)

    def scheme_refused(self) -> str:
        if self.forgetting_scheme != "constant-trace":
            return super().scheme_refused()
        return (
            "rknown-step cannot use constant-trace: this scheme forgets nothing at rest, but the "
            "subtracted noise is that of every sample; use exponential or window"
        )

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        noise = noise_covariance(self, self.noise_std)
        return config | {"compensated": 1, "noise": noise[:-1, :-1].tolist(), "target_noise": noise[:-1, -1].tolist()}
