"""What an estimator over whole records owes."""

from __future__ import annotations

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.results import Fit
from pmfid.testing.case import COPIES, Case, ContractError, require, require_refusal, result_of

SYMMETRIC = 1e-9


def copies_fit_alike(case: Case) -> None:
    """Also one of an estimator that has been at work."""
    worker, expected = case.configured, case.short_result.theta
    for name, again in COPIES.items():
        found = result_of(again(worker), *case.short).theta
        require(np.array_equal(found, expected), f"{name} fits other numbers")


def rest_is_not_identifiable(case: Case) -> None:
    """An output that does not move says nothing: NotIdentifiableError, not numbers."""
    n = case.fine.u.size
    still = np.zeros(n, np.int64)
    require_refusal(NotIdentifiableError, "a record at rest", lambda: result_of(case.configured, np.ones(n), still))


def covariance_is_one(case: Case) -> None:
    """Symmetric and positive definite; the residual is smaller than the target."""
    fit = case.coarse_result
    if not isinstance(fit, Fit):
        raise ContractError(f"fit gives a {type(fit).__name__}, not a Fit")
    correlation = fit.theta_cov / np.outer(fit.theta_std, fit.theta_std)
    require(bool(np.max(np.abs(correlation - correlation.T)) < SYMMETRIC), "theta_cov is not symmetric")
    require(bool(np.all(np.linalg.eigvalsh(correlation) > 0)), "theta_cov is not positive definite")
    require(0 <= fit.relative_error < 1, f"relative_error is {fit.relative_error}")
