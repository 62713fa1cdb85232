"""Interval likelihood: a count says between which two positions the axis is, and nothing more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pmfid.estimators.difference import invert_information
from pmfid.estimators.likelihood import Best, cost, expected_information
from pmfid.estimators.output_error import Following
from pmfid.estimators.phases import likelihood_covariance
from pmfid.estimators.results import Fit
from pmfid.status import Status


@dataclass(frozen=True)
class IntervalML(Following):
    """Maximum likelihood of the counts, off-line (Ljung 1999, section 7.4, for a quantised output).

    log L = sum log(Phi((b - x)/s) - Phi((a - x)/s)): x(k) the simulated position, a = resolution * counts and
    b = a + resolution the edges of the count, s the standard deviation of what else is in the position, estimated
    too, of at least 0.02 counts. Starts from `OE`. theta_cov is that of the expected information, not of the observed
    (far from the edges a count shows no curvature, whatever it says), or what the scores scatter where that is more:
    in blocks on every scale, as where the model is not quite right, and over the places that the encoder's lattice may
    have under this very motion.

    Where y - x is more than the encoder explains, and wherever `OE` has a high-pass, the edges of the counts say
    nothing on x: the result then comes from `OE`, with `Status.FALLBACK`. drift_cutoff: pole of a first-order high-pass
    on y - x [rad/s], 0: none, None: as for `OE`. initial: parameters by name to start from.
    """

    method: ClassVar[str] = "interval"

    def _fit(self, u: ArrayLike, counts: ArrayLike) -> Fit:
        """Raises NotIdentifiableError also where the simulation does not follow."""
        return self.fit_of(self.best(u, counts))

    def fit_of(self, best: Best) -> Fit:
        """The result at the motion that fits best."""
        if best.noise is None:
            return self.make_least_squares_fit(replace(best, status=best.status | int(Status.FALLBACK)))
        difference, q, noise = best.difference, best.q, best.noise
        error = difference(q)
        root = np.sqrt(expected_information(error, noise))
        own = self.own_sensitivity(difference, q, root)
        weighted, slope = own * root[:, None], cost(error, noise)[1]
        invert_information(weighted, self.names)
        covariance = likelihood_covariance(best, weighted, own * slope[:, None])
        return self.result(difference, q, self.with_drift(best, covariance), best.status)
