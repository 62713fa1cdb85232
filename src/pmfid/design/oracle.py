"""The best vertex for a linear objective, by HiGHS from the last basis (Huangfu and Hall 2018)."""

from __future__ import annotations

from dataclasses import replace

import highspy
import numpy as np
from scipy.sparse import csr_matrix, vstack

from pmfid.design.polytope import Polytope, input_set, model, nearest
from pmfid.design.tuning import TUNING
from pmfid.errors import PmfidError, UsageError
from pmfid.types import Floats

__all__ = ["EmptyError", "Oracle", "SolverError"]


class SolverError(PmfidError):
    """The linear solver gave up; not an answer about the problem."""


class EmptyError(SolverError):
    """There is no input within the limits and the restrictions."""


class Oracle:
    """Maximises linear functions of the input over a polytope, and over the ball that an energy limit adds to it.

    After `start` the answers depend on the objectives since then alone. Not for use by two threads at once.
    """

    def __init__(self, shape: Polytope) -> None:
        self.shape = shape
        self._highs = _load(shape)
        self._rows = self._highs.getNumRow()
        self._columns = np.arange(shape.inputs, dtype=np.int32)
        self._basis: highspy.HighsBasis | None = None
        self._centre: Floats | None = None
        self.solves = 0

    def feasible(self) -> bool:
        """Whether there is an input that meets all limits."""
        self._cost(np.zeros(self.shape.inputs))
        if self._run() != highspy.HighsModelStatus.kOptimal:
            return False
        self._basis = self._highs.getBasis()
        return not np.isfinite(self.shape.radius) or self._least_norm() <= self.shape.radius * (1 + 1e-9)

    def start(self) -> None:
        """Forgets what earlier objectives have left."""
        cuts = self._highs.getNumRow() - self._rows
        if cuts:
            self._highs.deleteRows(cuts, np.arange(self._rows, self._rows + cuts, dtype=np.int32))
        if self._basis is not None:
            self._highs.setBasis(self._basis)

    def maximise(self, objective: Floats) -> Floats:
        """An input (K,) that maximises objective' u. Raises SolverError if HiGHS finds no optimum."""
        u = self._vertex(objective)
        for _ in range(TUNING.max_cuts):
            if not u @ u > self.shape.radius**2 * (1 + TUNING.energy_tolerance):
                return u
            self._cut(u)
            u = self._vertex(objective)
        return self._retreat(u)

    def maximise_relaxed(self, objective: Floats) -> Floats:
        """Maximises with only the known tangents of the energy limit: the value is an upper bound of `maximise`."""
        return self._vertex(objective)

    def restrict(self, normal: Floats, lower: float, upper: float) -> int:
        """Adds lower <= normal' u <= upper until `start`; returns the row, for `release`."""
        self._highs.addRow(lower, upper, self.shape.inputs, self._columns, normal)
        return int(self._highs.getNumRow()) - 1

    def release(self, row: int) -> None:
        """Takes a restriction back."""
        self._highs.deleteRows(1, np.array([row], dtype=np.int32))

    def _vertex(self, objective: Floats) -> Floats:
        # HiGHS works to absolute tolerances: an objective of order one makes them relative
        size = float(np.abs(objective).max()) or 1.0
        self._cost(-objective / size)
        status = self._run()
        if status not in (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kInfeasible):
            status = self._solve_again()
        if status == highspy.HighsModelStatus.kInfeasible:
            raise EmptyError("no input meets all limits")
        if status in (highspy.HighsModelStatus.kUnbounded, highspy.HighsModelStatus.kUnboundedOrInfeasible):
            raise UsageError("the limits leave the input without a bound; give a limit for input, energy or rms")
        if status != highspy.HighsModelStatus.kOptimal:
            raise SolverError(
                f"the linear solver ended with {self._highs.modelStatusToString(status)!r}; "
                "rescale the problem (input of order 1) or take fewer intervals"
            )
        self.solves += 1
        return np.asarray(self._highs.getSolution().col_value)[: self.shape.inputs]

    def _cost(self, cost: Floats) -> None:
        self._highs.changeColsCost(self.shape.inputs, self._columns, cost)

    def _run(self) -> highspy.HighsModelStatus:
        self._highs.run()
        return self._highs.getModelStatus()

    def _solve_again(self) -> highspy.HighsModelStatus:
        """Solves once more, from nothing and with presolve."""
        self._highs.clearSolver()
        self._highs.setOptionValue("presolve", "on")
        status = self._run()
        self._highs.setOptionValue("presolve", "off")
        return status

    def _cut(self, u: Floats) -> None:
        """Cuts off a point outside the ball by the tangent below it."""
        normal = u / np.linalg.norm(u)
        if self._highs.getNumRow() >= self._rows + TUNING.oracle_kept:
            self.release(self._rows)
        self.restrict(normal, -np.inf, self.shape.radius)

    def _least_norm(self) -> float:
        free = replace(self.shape, radius=np.inf)
        self._centre = nearest(input_set(free), np.zeros(self.shape.inputs))
        return float(np.linalg.norm(self._centre))

    def _retreat(self, u: Floats) -> Floats:
        """From a point that still is a little outside the ball, towards the input of least norm, back into it."""
        if self._centre is None:
            self._least_norm()
        centre = np.asarray(self._centre)
        d = u - centre
        a, b, c = d @ d, d @ centre, centre @ centre - self.shape.radius**2
        return np.asarray(centre + d * max(0.0, (-b + np.sqrt(max(0.0, b * b - a * c))) / a))


def _load(shape: Polytope) -> highspy.Highs:
    """A HiGHS model; rows of one term become bounds of their column."""
    rows, lower, upper = _sum_rows(shape)
    terms = np.diff(rows.indptr)
    low, high = np.full(rows.shape[1], -np.inf), np.full(rows.shape[1], np.inf)
    low[: shape.inputs], high[: shape.inputs] = -shape.radius, shape.radius
    for i in np.flatnonzero(terms == 1):
        j, value = rows.indices[rows.indptr[i]], rows.data[rows.indptr[i]]
        ends = sorted((lower[i] / value, upper[i] / value))
        low[j], high[j] = max(low[j], ends[0]), min(high[j], ends[1])
    return model(rows[terms > 1].tocsc(), lower[terms > 1], upper[terms > 1], low, high)


def _sum_rows(shape: Polytope) -> tuple[csr_matrix, Floats, Floats]:
    """The rows; if only the last nominal position is limited, one sum of steps replaces all positions."""
    K, rows = shape.inputs, shape.matrix.tocsr()
    chain = np.flatnonzero([name == "motion" for name in shape.names])[: 2 * K : 2]
    inner = np.arange(K, 3 * K - 2, 2)
    if (np.diff(shape.matrix.indptr)[inner] > 2).any():
        return rows, shape.lower, shape.upper
    others = np.setdiff1d(np.arange(rows.shape[0]), chain)
    matrix = vstack([rows[others], csr_matrix(rows[chain].sum(axis=0))]).tocsr()
    matrix.data[np.abs(matrix.data) < 1e-15] = 0.0
    matrix.eliminate_zeros()
    total = shape.lower[chain].sum()
    return matrix, np.r_[shape.lower[others], total], np.r_[shape.upper[others], total]
