"""One number for an information matrix. All values are informations: larger is better, twice the data doubles them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pmfid.design.problem.problem import Problem
from pmfid.errors import UsageError, did_you_mean
from pmfid.types import Floats

__all__ = ["CRITERIA", "Criterion", "criterion_of", "eliminate"]

#: Name -> what it is, for p parameters of interest and their information S (nuisance parameters eliminated).
CRITERIA = {
    "trace": "trace S, the criterion of the paper; also T",
    "D": "det(S)^(1/p): volume of the confidence ellipsoid",
    "A": "p / trace(inverse of S): mean variance of the parameters",
    "E": "least eigenvalue of S: the worst known combination",
    "ME": "least over largest eigenvalue of S: roundness, not size",
    "c": "1 / (c' inverse(S) c): variance of one combination of the parameters",
}

#: Information below is none.
TINY = 1e-200


@dataclass(frozen=True, eq=False)
class Criterion:
    """A criterion for the first `size` of the parameters of F; the others are nuisance.

    combination: (size,) weights of the scaled parameters, for "c".
    """

    name: str
    size: int
    combination: Floats | None = None

    def log_value(self, F: Floats) -> Floats:
        """Logarithm of the value; F: (..., p, p), returns (...); -inf if F is singular."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.log(_value(self.name, _schur(F, self.size), self.combination))
        return np.where(np.isnan(value), -np.inf, value)

    def value(self, F: Floats) -> float:
        return float(np.exp(self.log_value(F)))

    def gradient(self, F: Floats) -> Floats:
        """d log value / d F, symmetric, (p, p); if F is singular, the gradient at a nearby regular matrix."""
        S, G = eliminate(F, self.size)
        try:
            slope = _slope(self.name, S, self.combination)
        except np.linalg.LinAlgError:
            size = float(np.trace(S))
            ridge = 1e-9 * (size if size > TINY else 1.0)
            slope = _slope(self.name, S + ridge * np.eye(self.size), self.combination)
        return np.asarray(G @ slope @ G.T)

    @property
    def concave(self) -> bool:
        """The value is a concave function of F: then information of a mixture has a bound (Kiefer 1974)."""
        return self.name != "ME"


def criterion_of(problem: Problem, name: str, combination: Mapping[str, float] | None = None) -> Criterion:
    """The criterion of that name for the unknown parameters of a problem.

    combination: weights {unknown parameter: weight} for "c".
    Raises UsageError for an unknown name or a wrong combination.
    """
    known = {**{key: key for key in CRITERIA}, "T": "trace"}
    if name not in known:
        raise UsageError(f"criterion must be one of {', '.join(CRITERIA)}, got {name!r}{did_you_mean(name, CRITERIA)}")
    size = len(problem.unknown)
    if known[name] != "c":
        return Criterion(known[name], size)
    weights = dict(combination or {})
    if not any(weights.values()) or set(weights) - set(problem.unknown):
        raise UsageError(f"criterion c needs combination, weights of {problem.unknown}, got {weights}")
    vector = np.array([weights.get(key, 0.0) for key in problem.unknown]) * problem.scale[:size]
    return Criterion("c", size, vector / np.linalg.norm(vector))


def eliminate(F: Floats, size: int) -> tuple[Floats, Floats]:
    """Information S = G' F G on the first `size` parameters where the others are estimated too, (size, size), and G."""
    G = np.eye(len(F))[:, :size]
    if len(F) == size:
        return F, G
    G[size:] = -np.linalg.solve(F[size:, size:], F[size:, :size])
    return np.asarray(G.T @ F @ G), G


def _schur(F: Floats, size: int) -> Floats:
    S = F[..., :size, :size]
    if F.shape[-1] == size:
        return S
    return np.asarray(S - F[..., :size, size:] @ np.linalg.solve(F[..., size:, size:], F[..., size:, :size]))


def _value(name: str, S: Floats, combination: Floats | None) -> Floats:
    p = S.shape[-1]
    if name == "trace":
        return np.asarray(np.trace(S, axis1=-2, axis2=-1))
    if name == "D":
        sign, log = np.linalg.slogdet(S)
        return np.asarray(np.where(sign > 0, np.exp(log / p), 0.0))
    if name == "c":
        return _evaluate_along(S, np.ones(p) if combination is None else combination)
    eigenvalues = np.maximum(np.linalg.eigvalsh(S), 0.0)
    if name == "A":
        return np.asarray(p / (1.0 / eigenvalues).sum(axis=-1))
    if name == "E":
        return np.asarray(eigenvalues[..., 0])
    return np.asarray(eigenvalues[..., 0] / eigenvalues[..., -1])


def _evaluate_along(S: Floats, combination: Floats) -> Floats:
    eigenvalues, vectors = np.linalg.eigh(S)
    part = np.einsum("...ij,i->...j", vectors, combination)
    return np.asarray(1.0 / (part**2 / np.maximum(eigenvalues, 0.0)).sum(axis=-1))


def _slope(name: str, S: Floats, combination: Floats | None) -> Floats:
    """d log value / d S. Raises LinAlgError if S is singular, and with `trace` where it is nothing."""
    p = len(S)
    if name == "trace" and np.trace(S) > TINY:
        return np.asarray(np.eye(p) / np.trace(S))
    if name == "D":
        return np.asarray(np.linalg.inv(S) / p)
    if name == "A":
        inverse = np.linalg.inv(S)
        return np.asarray(inverse @ inverse / np.trace(inverse))
    if name == "c" and combination is not None:
        pull = np.linalg.solve(S, combination)
        return np.outer(pull, pull) / float(combination @ pull)
    eigenvalues, vectors = np.linalg.eigh(S)
    if name == "trace" or not eigenvalues[0] > 0:
        raise np.linalg.LinAlgError("no information")
    least = np.outer(vectors[:, 0], vectors[:, 0]) / eigenvalues[0]
    if name == "E":
        return np.asarray(least)
    return np.asarray(least - np.outer(vectors[:, -1], vectors[:, -1]) / eigenvalues[-1])
