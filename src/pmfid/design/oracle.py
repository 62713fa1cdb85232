"""The best vertex for a linear objective, by HiGHS from the last basis (Huangfu and Hall 2018).

SciPy has HiGHS too, but without a warm start, and therefore takes ten times as long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix

from pmfid.design.polytope import EQUAL, InputSet, nearest_of_any_energy, retreat
from pmfid.errors import PmfidError, UsageError
from pmfid.types import Floats

if TYPE_CHECKING:
    import highspy

#: Largest number of tangents that one answer may add, and that are kept in total.
MAX_CUTS = 5
ORACLE_KEPT = 60

__all__ = ["EmptyError", "Oracle", "SolverError"]

#: After a change of the objective, the primal simplex continues from the last vertex.
OPTIONS: dict[str, bool | int | str] = {
    "output_flag": False,
    "threads": 1,
    "presolve": "off",
    "simplex_strategy": 4,
}


class SolverError(PmfidError):
    """Raised if the linear solver gives up, which says nothing about the problem."""


class EmptyError(SolverError):
    """Raised if no input lies within the limits and the restrictions."""


class Oracle:
    """A maximiser of linear functions of the input over a polytope and the ball of an energy limit.

    The answers after `start` depend only on the objectives since then. Two threads must not share one oracle.
    """

    def __init__(self, inputs: InputSet) -> None:
        self.inputs = inputs
        self._highs = _load(inputs)
        self._rows = self._highs.getNumRow()
        self._columns = np.arange(inputs.size, dtype=np.int32)
        self._basis: highspy.HighsBasis | None = None
        self._centre: Floats | None = None

    def feasible(self) -> bool:
        """Return whether an input meets all limits."""
        self._cost(np.zeros(self.inputs.size))
        if self._run() != "Optimal":
            return False
        self._basis = self._highs.getBasis()
        if not np.isfinite(self.inputs.radius):
            return True
        return float(np.linalg.norm(self._least_energy())) <= self.inputs.radius * (1 + EQUAL)

    def start(self) -> None:
        """Remove the rows and the basis that earlier objectives have left."""
        cuts = self._highs.getNumRow() - self._rows
        if cuts:
            self._highs.deleteRows(cuts, np.arange(self._rows, self._rows + cuts, dtype=np.int32))
        if self._basis is not None:
            self._highs.setBasis(self._basis)

    def maximise(self, objective: Floats) -> Floats:
        """Return an input (K,) that maximises objective' u. Raises SolverError if HiGHS finds no optimum."""
        u = self.maximise_relaxed(objective)
        for _ in range(MAX_CUTS):
            if not u @ u > self.inputs.radius**2 * (1 + EQUAL):
                return u
            self._cut(u)
            u = self.maximise_relaxed(objective)
        return retreat(self.inputs, self._least_energy(), u)

    def maximise_relaxed(self, objective: Floats) -> Floats:
        """Return an input (K,) that maximises objective' u, with the known tangents in place of the energy limit.

        The value at this input is an upper bound of the value from `maximise`.
        """
        # HiGHS works to absolute tolerances. An objective of order one makes these tolerances relative.
        size = float(np.abs(objective).max()) or 1.0
        self._cost(-objective / size)
        status = self._run()
        if status not in ("Optimal", "Infeasible"):
            status = self._run_again()
        if status == "Infeasible":
            raise EmptyError("no input meets all limits")
        if status in ("Unbounded", "UnboundedOrInfeasible"):
            raise UsageError("the limits do not bound the input; give a limit for input, energy or rms")
        if status != "Optimal":
            raise SolverError(
                f"the linear solver ended with {status!r}; "
                "rescale the problem (input of order 1) or take fewer intervals"
            )
        return np.asarray(self._highs.getSolution().col_value)

    def restrict(self, normal: Floats, lower: float, upper: float) -> int:
        """Add lower <= normal' u <= upper until `start`, and return the number of the row for `release`."""
        self._highs.addRow(lower, upper, self.inputs.size, self._columns, normal)
        return int(self._highs.getNumRow()) - 1

    def release(self, row: int) -> None:
        """Remove a restriction."""
        self._highs.deleteRows(1, np.array([row], dtype=np.int32))

    def _cost(self, cost: Floats) -> None:
        self._highs.changeColsCost(self.inputs.size, self._columns, cost)

    def _run(self) -> str:
        self._highs.run()
        return str(self._highs.getModelStatus().name).removeprefix("k")

    def _run_again(self) -> str:
        """Run the solver from scratch and with presolve."""
        self._highs.clearSolver()
        self._highs.setOptionValue("presolve", "on")
        status = self._run()
        self._highs.setOptionValue("presolve", "off")
        return status

    def _cut(self, u: Floats) -> None:
        """Cut off a point outside the ball by the tangent below it."""
        if self._highs.getNumRow() >= self._rows + ORACLE_KEPT:
            self.release(self._rows)
        self.restrict(u / np.linalg.norm(u), -np.inf, self.inputs.radius)

    def _least_energy(self) -> Floats:
        if self._centre is None:
            self._centre = nearest_of_any_energy(self.inputs, np.zeros(self.inputs.size))
        return self._centre


def _load(inputs: InputSet) -> highspy.Highs:
    """Return a HiGHS model without an objective. Rows of one term become bounds of their column."""
    try:
        import highspy
    except ImportError:
        raise UsageError("a design needs the solver HiGHS: pip install 'pmfid[design]'") from None
    terms = np.count_nonzero(inputs.matrix, axis=1)
    high = np.full(inputs.size, inputs.radius)
    low = -high
    for row, lower, upper in zip(
        *(part[terms == 1] for part in (inputs.matrix, inputs.lower, inputs.upper)), strict=True
    ):
        (j,) = np.flatnonzero(row)
        ends = sorted((lower / row[j], upper / row[j]))
        low[j], high[j] = max(low[j], ends[0]), min(high[j], ends[1])
    rows = inputs.matrix[terms > 1]
    size = np.abs(rows).max(axis=1, initial=1e-300)  # Rows are scaled, because HiGHS works to absolute tolerances.
    matrix = csc_matrix(rows / size[:, None])
    lp = highspy.HighsLp()
    lp.num_row_, lp.num_col_ = matrix.shape
    lp.col_cost_ = np.zeros(lp.num_col_)
    lp.col_lower_, lp.col_upper_ = low, high
    lp.row_lower_, lp.row_upper_ = inputs.lower[terms > 1] / size, inputs.upper[terms > 1] / size
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_, lp.a_matrix_.index_, lp.a_matrix_.value_ = matrix.indptr, matrix.indices, matrix.data
    highs = highspy.Highs()  # type: ignore[no-untyped-call]
    for name, value in OPTIONS.items():
        highs.setOptionValue(name, value)
    highs.passModel(lp)
    return highs
