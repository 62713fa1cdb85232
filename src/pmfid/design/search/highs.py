"""Programs for HiGHS (Huangfu and Hall 2018): linear ones, and the least norm under linear limits."""

from __future__ import annotations

import highspy
import numpy as np
from scipy.sparse import csc_matrix

from pmfid.design.problem.problem import InfeasibleError
from pmfid.types import Floats

__all__ = ["least_norm", "model"]

#: The primal simplex goes on from the last vertex when the objective changes.
OPTIONS: dict[str, bool | int | str] = {
    "output_flag": False,
    "threads": 1,
    "presolve": "off",
    "simplex_strategy": 4,
}


def model(matrix: csc_matrix, lower: Floats, upper: Floats, low: Floats, high: Floats) -> highspy.Highs:
    """HiGHS with lower <= matrix z <= upper, low <= z <= high and no objective yet."""
    lp = highspy.HighsLp()
    lp.num_row_, lp.num_col_ = matrix.shape
    lp.col_cost_ = np.zeros(lp.num_col_)
    lp.col_lower_, lp.col_upper_ = low, high
    lp.row_lower_, lp.row_upper_ = lower, upper
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_, lp.a_matrix_.index_ = matrix.indptr, matrix.indices
    lp.a_matrix_.value_ = matrix.data
    highs = highspy.Highs()  # type: ignore[no-untyped-call]
    for name, value in OPTIONS.items():
        highs.setOptionValue(name, value)
    highs.passModel(lp)
    return highs


def least_norm(G: Floats, h: Floats) -> Floats:
    """d (n,) of least norm with G d >= h, (m, n) and (m,), by the quadratic solver of HiGHS, to 1e-6.

    Raises InfeasibleError if there is none.
    """
    n = G.shape[1]
    highs = model(csc_matrix(G), h, np.full(len(h), np.inf), np.full(n, -np.inf), np.full(n, np.inf))
    hessian = highspy.HighsHessian()
    hessian.dim_, hessian.format_ = n, highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = np.arange(n + 1), np.arange(n), np.ones(n)
    highs.passHessian(hessian)
    highs.run()
    if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        raise InfeasibleError("no input meets all limits; relax one of them")
    return np.array(highs.getSolution().col_value)
