"""What an input and an encoder show of two masses, from the derivatives of the body."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmfid._body import ELASTIC_BASE
from pmfid.errors import UsageError
from pmfid.fit.elastic import ROWS
from pmfid.fit.likelihood import ROUNDING
from pmfid.fit.machine import OFFSET, Excitation, simulate
from pmfid.fit.posterior import STEPS, allowed_region
from pmfid.fit.problem import PARTS, FitProblem
from pmfid.fit.shooting import settle_starts
from pmfid.fit.solve import START, root_of_rows
from pmfid.fit.starts import soften
from pmfid.fit.within import information_rows, stack
from pmfid.models.controllers import MotorAndLoad
from pmfid.types import Floats

#: Places of the parameters of a `MotorAndLoad` in the body, in their order.
PLACES = [row for row in ROWS if row != OFFSET]
#: Steps of the walk of a prediction, whose standard deviations have an error of about 7 %.
FEW_STEPS = STEPS // 5


def predict_errors(masses: MotorAndLoad, u: ArrayLike, dt: float, resolution: float) -> dict[str, float]:
    """Return the relative standard errors of least squares on the counts of the motor, by parameter.

    A fit that explains each count reaches smaller errors.

    Parameters
    ----------
    masses
        Expected machine, with parameters above zero.
    u
        (n,) force or torque of the motor [N or N m], held for each sample.
    dt
        Sample period [s].
    resolution
        Travel of a count [m or rad]. The error of a count is uniform, and independent of its neighbours. The motion
        therefore needs to cross counts all the time.

    Raises
    ------
    UsageError
        If a parameter is not above zero, or if the input is not a finite array.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.fit.prediction import predict_errors
    >>> from pmfid.models.controllers import MotorAndLoad
    >>> belt = MotorAndLoad(2e-4, 4e-4, 0.01, 3e-4, 6e-4, 0.015, 4.55, 0.0014, rotary=True)
    >>> u = 0.15 * np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 400), 10)
    >>> round(100 * predict_errors(belt, u, 0.001, 2 * np.pi / 512)["stiffness"], 3)
    0.024
    """
    names = tuple(vars(masses))[: len(PLACES)]
    values = np.array([getattr(masses, name) for name in names])
    inputs = np.ascontiguousarray(u, np.float64)
    if inputs.ndim != 1 or inputs.size < 2 or not np.all(np.isfinite(inputs)) or not np.all(values > 0):
        raise UsageError("give masses with parameters above zero, and an input (n,) of finite numbers")
    theta = np.zeros(ELASTIC_BASE)
    theta[PLACES] = values
    row = np.arange(inputs.size + 1, dtype=np.int32)
    drive = Excitation(np.full(inputs.size, dt), inputs, row, np.zeros((0, inputs.size)))
    slopes = simulate(drive, [], theta, PARTS, np.eye(theta.size)[:, PLACES], elastic=True)[2] * values
    root = np.linalg.pinv(slopes - slopes.mean(axis=0), rcond=1e-12)  # the first position is unknown
    errors = resolution / np.sqrt(12) * np.sqrt(np.sum(root**2, axis=1))
    return dict(zip(names, errors.tolist(), strict=True))


def expect_covariance(x: Floats, slopes: Floats, precision: Floats) -> Floats:
    """Return the covariance (p, p) of a fit that explains the counts of a motion x (n,) [counts].

    `slopes` (n, p) are the derivatives of x, and `precision` (p,) those of the parameters' prior. The start position is
    unknown. The counts leave a region of parameters, which is several times smaller than least squares say.
    """
    J, precision = np.column_stack([slopes, np.ones(x.size)]), np.append(precision, START[0])
    root = root_of_rows(np.vstack([J / np.sqrt(ROUNDING), np.diag(np.sqrt(precision))]))
    bound, rng, prior = np.full(x.size, 0.5), np.random.default_rng(1), (precision, np.zeros(precision.size))
    _, covariance = allowed_region(x - np.floor(x) - 0.5, J, bound, root, rng, prior, FEW_STEPS)
    return covariance[:-1, :-1]


def predict_fit(problem: FitProblem, theta: Floats) -> Floats:
    """Return the relative standard errors (p,) of least squares on the counts of a record, for the machine at theta."""
    q = problem.start(theta)
    starts = settle_starts(problem, soften(problem.stretches), q, problem.first_starts())
    J = stack(problem.linearise(q, starts))[1]
    root = root_of_rows(information_rows(J, np.zeros(q.size), starts))
    std: Floats = np.linalg.norm(root[: q.size], axis=1)
    relative = np.isin(range(q.size), problem.machine.logs)
    return np.where(relative, std, std / np.abs(theta))
