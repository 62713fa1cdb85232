"""One model of a drive at its best fit, and what is to be known of two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.estimators.adequacy import Adequacy, information_of, score_variance, weigh
from pmfid.estimators.candidate_forces import PeriodicForce
from pmfid.estimators.difference import Difference, remove_nuisance, rms
from pmfid.estimators.interval import IntervalML
from pmfid.estimators.likelihood import Best
from pmfid.estimators.scatter import TINY
from pmfid.models.drive import Drive
from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    OFFSET,
    ROLES,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
    Equation,
)
from pmfid.types import Floats

#: A step of parameters for a derivative.
SMALL = 1e-4


@dataclass(frozen=True)
class Trial:
    """A model at its best fit to a record. log_likelihood: of the counts, in natural units; places: what may come again
    along the travel, to look for."""

    model: Drive
    method: IntervalML
    best: Best
    log_likelihood: float

    @property
    def difference(self) -> Difference:
        return self.best.difference

    @property
    def theta(self) -> Floats:
        """(p,) parameters of the equation, followed by those that it is not linear in."""
        return np.asarray((self.best.q * self.difference.scale)[:-2])

    @property
    def parameters(self) -> int:
        return self.difference.parameters

    def weigh_forces(self, places: Sequence[PeriodicForce] = ()) -> Adequacy:
        return weigh(self.best, places)

    @property
    def usual_speed(self) -> float:
        """Root mean square velocity of the simulated motion."""
        velocity = self.difference.motion(self.best.q)[1]
        return rms(velocity[velocity != 0])


def inflation(before: Trial, after: Trial) -> float:
    """Ratio of the scatter of the scores of a model's new terms, at its fit, to the scatter of independent errors.
    Chance inflates likelihood ratios by this factor. The largest over all new directions."""
    best, old, new = after.best, before.model.equation, after.model.equation
    difference, p = best.difference, best.difference.parameters
    sensitivity = -difference.jacobian(best.q)
    own = remove_nuisance(difference, sensitivity[:, :p], sensitivity[:, p:]) / difference.scale[:p]
    steps = SMALL * np.maximum(np.abs(before.theta), SMALL * float(np.max(np.abs(before.theta))))
    begin = carry_parameters(old, before.theta, new)
    moves = [(carry_parameters(old, before.theta + step, new) - begin) / float(np.sum(step)) for step in np.diag(steps)]
    shared = own @ np.column_stack(moves)
    shared /= np.maximum(np.linalg.norm(shared, axis=0), TINY)
    own /= np.maximum(np.linalg.norm(own, axis=0), TINY)
    alone = own - shared @ np.linalg.lstsq(shared, own)[0]
    directions = np.linalg.svd(alone, full_matrices=False)[0][:, : max(1, p - len(moves))]
    information, slope = information_of(best)
    return float(np.max(score_variance(best, directions, information, slope)) / information)


def known_shapes(best: Best) -> Best:
    """The same motion, from an equation whose shape parameters are known."""
    difference, q = best.difference, best.q
    p = len(difference.equation.names)
    equation = difference.equation.known_at((q * difference.scale)[p:-2])
    keep = np.r_[0:p, q.size - 2 : q.size]
    linear = replace(difference, equation=equation, scale=difference.scale[keep])
    return replace(best, difference=linear, least=best.least[keep], q=q[keep])


def carry_parameters(before: Equation, theta: Floats, after: Equation) -> Floats:
    """Parameters (p,) of one equation as start values of another; parameters that only the latter has are zero."""
    own = before.role_values(theta)
    body, further = (
        own[: len(ROLES)],
        dict(zip([n for n, _ in before.further], theta[len(before.names) :], strict=True)),
    )
    offset = body[OFFSET]
    found = np.zeros(len(after.names))
    if after.roles[OFFSET] is None:
        body[COULOMB_FORWARD] += offset
        body[COULOMB_BACKWARD] -= offset
    elif before.roles[OFFSET] is None:
        body[OFFSET] = (body[COULOMB_FORWARD] - body[COULOMB_BACKWARD]) / 2
    for forward, backward in ((VISCOUS_FORWARD, VISCOUS_BACKWARD), (COULOMB_FORWARD, COULOMB_BACKWARD)):
        if after.roles[forward] == after.roles[backward]:
            body[forward] = body[backward] = (body[forward] + body[backward]) / 2
    for value, index in zip(body, after.roles, strict=False):
        if index is not None:
            found[index] = value
    sizes = dict(zip(before.names, theta, strict=False))
    for index, term in enumerate(after.unknown):
        if term.shape is not None:
            found[index] = sizes.get(str(term.name), 0.0)
    found = np.where(after.positive, np.maximum(found, 0.0), found)
    return np.asarray(np.r_[found, [further.get(name, 0.0) for name, _ in after.further]])
