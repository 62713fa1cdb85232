"""Off-line least squares, plain and with compensation of the encoder's bias."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.least_squares import inverse_of, solve_with_instruments
from pmfid.estimators.results import Columns


@dataclass(frozen=True)
class BCLS(BatchEstimator):
    """Off-line bias-compensated least squares (paper eq. 17 to 32); see `BCRLS`.

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.

    Notes
    -----
    theta = (sum zeta phi^T)^-1 sum zeta z.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import BCLS, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = BCLS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.theta.round(2)
    array([ 1.07, 12.81,  0.8 ])
    """

    method: ClassVar[str] = "bcls"
    instrumental: ClassVar[bool] = True

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return solve_with_instruments(columns)


@dataclass(frozen=True)
class LS(BatchEstimator):
    """Off-line least squares by orthogonal decomposition (paper eq. 17).

    Parameters
    ----------
    model, encoder, dt, cutoff
        See `IV`.
    prefilter_zeros : sequence of float, optional
        Zeros of the pre-filter [rad/s]. With these zeros, the result is the biased estimate of the extended model
        (paper eq. 19 to 21).

    Notes
    -----
    theta = (sum phi phi^T)^-1 sum phi z. Quantisation makes this estimate biased; `BCLS` compensates the bias.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import LS, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> fit = LS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0).fit(u, counts)
    >>> fit.names
    ('mass', 'viscous_friction', 'coulomb_friction')
    """

    method: ClassVar[str] = "ls"

    def _solve(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = np.linalg.norm(columns.phi, axis=0)
        Q, R = np.linalg.qr(columns.phi / scale)
        inverse = inverse_of(R)
        return inverse @ (Q.T @ columns.z) / scale, inverse @ inverse.T / np.outer(scale, scale)
