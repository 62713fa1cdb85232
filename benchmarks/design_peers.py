"""The designs of `benchmarks.design` with CasADi and IPOPT, as their users would write them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmfid.design.fisher import affine
from pmfid.design.problem import Problem
from pmfid.types import Floats


@dataclass(frozen=True)
class Tried:
    """The value of each start (n,), 0 if the solver failed, and its processor seconds (n,)."""

    values: Floats
    seconds: Floats


def casadi_starts(problem: Problem, criterion: str, starts: int, seed: int) -> Tried:
    """Solve by multiple shooting with exact steps and IPOPT with exact second derivatives.

    The program is built once, untimed. The variables of the program are position, velocity and their sensitivities at
    the nodes. For D and A the information is a variable, too, for D by its Cholesky factor. A start is a random input
    within its limits with the motion that it causes.
    """
    import casadi

    program = _Program(casadi, problem, criterion)
    rng = np.random.default_rng(seed)
    values, seconds = [], []
    for _ in range(starts):
        low, high = problem.limits.pair("input") or (-1.0, 1.0)
        guess = program.guess(rng.uniform(low, high, problem.intervals))
        began = time.process_time()
        value = program.solve(guess)
        seconds.append(time.process_time() - began)
        values.append(value)
    return Tried(np.array(values), np.array(seconds))


class _Program:
    def __init__(self, casadi: Any, problem: Problem, criterion: str) -> None:
        from pmfid.design.fisher import discretise, drive_regime

        self.problem, self.criterion, self.maps = problem, criterion, affine(problem)
        step = discretise(drive_regime(problem.drive, problem.nominal, problem.names, 1), problem.dt)
        self.step = step
        K, p = problem.intervals, len(problem.names)
        n = 2 * (p + 1)
        unit = problem.scale / np.sqrt(problem.variance)
        # units of the sensitivities in which the information is of order one
        self.unit = unit / np.sqrt(self._typical())
        self.states = np.concatenate([np.ones(2), np.repeat(self.unit, 2)])
        A = step.A * self.states[:, None] / self.states[None, :]
        b, g = step.b * self.states, step.g * self.states
        U, X = casadi.MX.sym("U", K), casadi.MX.sym("X", n, K)
        before = casadi.horzcat(casadi.DM(np.r_[problem.start, np.zeros(2 * p)]), X[:, : K - 1])
        gaps = X - (casadi.DM(A) @ before + casadi.DM(b) @ U.T + casadi.repmat(casadi.DM(g), 1, K))
        S = casadi.vertcat(*[X[2 * (i + 1), :] for i in range(p)])
        variables, equations = [U, casadi.vec(X)], [casadi.vec(gaps)]
        L = None
        if criterion == "trace":
            objective = -casadi.sumsqr(S)
        elif criterion == "D":
            L = casadi.MX.sym("L", p * (p + 1) // 2)
            lower = _triangle(casadi, L, p)
            equations.append(casadi.vec(_half(casadi, S @ S.T - lower @ lower.T, p)))
            objective = -2 * casadi.sum1(casadi.log(casadi.diag(lower)))
        else:
            L = casadi.MX.sym("L", p * (p + 1) // 2)
            lower = _triangle(casadi, L, p)
            equations.append(casadi.vec(_half(casadi, S @ S.T - lower @ lower.T, p)))
            objective = casadi.log(casadi.sumsqr(_inverse(casadi, lower, p)))
        variables += [L] if L is not None else []
        self.n, self.K, self.p, self.lifted = n, K, p, L is not None
        options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "expand": True, "ipopt.max_iter": 1000}
        nlp = {"x": casadi.vertcat(*variables), "f": objective, "g": casadi.vertcat(*equations)}
        self.solver = casadi.nlpsol("design", "ipopt", nlp, options)
        self.low, self.high = self._bounds()

    def _typical(self) -> Floats:
        """Return the information of a mid-range input, which scales the variables to order one."""
        high = (self.problem.limits.pair("input") or (-1.0, 1.0))[1]
        F = self.maps.information(np.linspace(0.5 * high, 0.2 * high, self.problem.intervals))
        return np.asarray(F.diagonal())

    def _bounds(self) -> tuple[Floats, Floats]:
        problem, K, n = self.problem, self.K, self.n
        low, high = np.full((n, K), -np.inf), np.full((n, K), np.inf)
        low[0], high[0] = problem.limits.pair("position") or (-np.inf, np.inf)
        low[1] = problem.limits.min_speed
        low[:2, -1] = high[:2, -1] = problem.end
        u = problem.limits.pair("input") or (-np.inf, np.inf)
        ends = [np.full(K, u[0]), low.T.ravel()], [np.full(K, u[1]), high.T.ravel()]
        if self.lifted:
            diagonal = [i == j for i in range(self.p) for j in range(i + 1)]
            ends[0].append(np.where(diagonal, 1e-9, -np.inf))
            ends[1].append(np.full(len(diagonal), np.inf))
        return np.concatenate(ends[0]), np.concatenate(ends[1])

    def guess(self, u: Floats) -> Floats:
        X = [np.r_[self.problem.start, np.zeros(2 * self.p)]]
        for value in u:
            X.append(self.step.A @ X[-1] + self.step.b * value + self.step.g)
        states = np.array(X[1:]) * self.states
        parts = [u, states.ravel()]
        if self.lifted:
            S = states[:, 2::2].T
            L = np.linalg.cholesky(S @ S.T + 1e-9 * np.eye(self.p))
            parts.append(np.array([L[i, j] for i in range(self.p) for j in range(i + 1)]))
        return np.concatenate(parts)

    def solve(self, guess: Floats) -> float:
        found = self.solver(x0=guess, lbx=self.low, ubx=self.high, lbg=0, ubg=0)
        if not self.solver.stats()["success"]:
            return 0.0
        from pmfid.design.fisher import criterion_of

        u = np.asarray(found["x"]).ravel()[: self.K]
        return criterion_of(self.problem, self.criterion).value(self.maps.information(u))


def _triangle(casadi: Any, entries: Any, p: int) -> Any:
    rows, k = [], 0
    for i in range(p):
        row = [entries[k + j] for j in range(i + 1)]
        k += i + 1
        rows.append(casadi.horzcat(*row, *([0] * (p - i - 1))))
    return casadi.vertcat(*rows)


def _inverse(casadi: Any, lower: Any, p: int) -> Any:
    """Return the inverse of a lower triangle, by forward substitution."""
    rows: list[list[Any]] = []
    for i in range(p):
        row = [-sum(lower[i, k] * rows[k][j] for k in range(j, i)) / lower[i, i] for j in range(i)]
        rows.append([*row, 1 / lower[i, i], *([0] * (p - i - 1))])
    return casadi.vertcat(*[casadi.horzcat(*row) for row in rows])


def _half(casadi: Any, matrix: Any, p: int) -> Any:
    return casadi.vertcat(*[matrix[i, j] for i in range(p) for j in range(i + 1)])
