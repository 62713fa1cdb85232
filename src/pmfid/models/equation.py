"""The equation object: terms, linear in the unknown coefficients, between derivatives of signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pmfid.errors import UsageError

#: `output`: the measured position; `input`: what drives the plant; `direction`: sign of the velocity, at a
#: reversal inside a sample as the signed moving fraction; `moving`: 1 while the plant moves (a constant load);
#: `forward`, `backward`: 1 while it moves forward, -1 while it moves backward; `forward_output`, `backward_output`:
#: the position as far as it changes in that direction.
Signal = Literal["output", "input", "direction", "moving", "forward", "backward", "forward_output", "backward_output"]


@dataclass(frozen=True)
class Term:
    """coefficient * d^derivative signal / dt^derivative, the coefficient unknown (it has a name) or known.

    signal: see `Signal`. derivative: order, >= 0. name, unit: of an unknown coefficient; None, if it is known.
    coefficient: the known value; 1 for an unknown one. noisy: the term carries the noise of the measured output.
    """

    signal: Signal
    derivative: int = 0
    name: str | None = None
    unit: str = ""
    coefficient: float = 1.0
    noisy: bool = False


@dataclass(frozen=True)
class Equation:
    """sum of `unknown` terms = sum of `known` terms (theory: sum theta_i D^j w_i = D^j w_0).

    The order is the highest derivative of the output among the unknown terms.
    Raises UsageError where there is no unknown or no known term, or where two unknowns share a name.
    """

    unknown: tuple[Term, ...]
    known: tuple[Term, ...]

    def __post_init__(self) -> None:
        names = [term.name for term in self.unknown]
        if not self.unknown or not self.known or None in names or len(set(names)) < len(names):
            raise UsageError(
                f"an equation needs unknown terms with different names and at least one known term, got {names}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(term.name or "" for term in self.unknown)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(term.unit for term in self.unknown)

    @property
    def order(self) -> int:
        return max(term.derivative for term in self.unknown if term.signal == "output")

    @property
    def noisy(self) -> tuple[int, ...]:
        """Columns that carry noise, highest derivative first (what G selects in paper eq. 22)."""
        columns = [i for i, term in enumerate(self.unknown) if term.noisy]
        return tuple(sorted(columns, key=lambda i: -self.unknown[i].derivative))
