"""What a design is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pmfid.design.problem.problem import Problem
from pmfid.presentation import Presentable, Summary, plain_dict
from pmfid.types import Floats

__all__ = ["Design"]


@dataclass(frozen=True, eq=False, repr=False)
class Design(Presentable):
    """An input, its nominal motion, and what it tells.

    t: (n+1,) nodes [s]; u: (n,) input, held from t[k] to t[k+1]; x, v: (n+1,) nominal position [m] and velocity [m/s].
    fisher: (p, p) information on the *unknown* parameters in their own units, prior included, nuisance ones eliminated.
    value: of the criterion, larger is better (see `criteria`); bound: proved upper bound of it, or None; it holds for
    the problem's time grid and directions. starts: how many, reached: fraction of them within 0.1 % of the best.
    """

    problem: Problem
    criterion: str
    t: Floats
    u: Floats
    x: Floats
    v: Floats
    fisher: Floats
    value: float
    bound: float | None = None
    starts: int = 1
    reached: float = 1.0
    solve_seconds: float = 0.0
    feasible: bool = True
    warnings: tuple[str, ...] = ()

    @property
    def gap(self) -> float | None:
        """Proved bound over value, minus 1; None if no bound is proved."""
        return None if self.bound is None else max(0.0, self.bound / self.value - 1.0)

    @property
    def predicted_std(self) -> dict[str, float]:
        """Standard deviation of each unknown parameter after one run, Cramér-Rao; inf if it has no information."""
        from numpy.linalg import LinAlgError, inv

        names = self.problem.unknown
        try:
            variance = inv(self.fisher).diagonal()
        except LinAlgError:
            return dict.fromkeys(names, math.inf)
        return {name: math.sqrt(v) if v > 0 else math.inf for name, v in zip(names, variance, strict=True)}

    def summary(self) -> Summary:
        """The predicted standard deviations after one run."""
        proved = "no bound proved" if self.gap is None else f"at most {100 * self.gap:.3g} % below the optimum"
        title = f"design by {self.criterion}: {self.u.size} intervals over {self.t[-1]:g} s, {proved}; after one run:"
        nominal = self.problem.nominal
        rows = [
            (name, f"{nominal[name]:.4g}", f"{std:.2g}", f"{100 * std / abs(nominal[name]):.2g}")
            for name, std in self.predicted_std.items()
        ]
        lines = [f"{name} = {value} ± {std}, {percent} %" for name, value, std, percent in rows]
        return Summary(title, ("parameter", "nominal", "std", "std [%]"), rows, lines, self.warnings)

    def columns(self) -> dict[str, object]:
        """A row for each interval, at its beginning."""
        return {"t": self.t[:-1], "u": self.u, "x": self.x[:-1], "v": self.v[:-1]}

    def to_dict(self) -> dict[str, object]:
        own = {"criterion": self.criterion, "value": self.value, "bound": self.bound, "gap": self.gap}
        return plain_dict({**own, "predicted_std": self.predicted_std, "warnings": self.warnings, **self.columns()})
