"""The level of a process: where its equation has a constant, its output may as well be counted from the first value."""

from __future__ import annotations

from dataclasses import dataclass

from pmfid.models.equation import Equation


@dataclass(frozen=True)
class Level:
    """What the output's level is in, as indices of parameters.

    y - first has the equation of y, but its constant is theta[constant] - ratio * first * theta[lowest].
    lowest: None where the output itself is in no term, so that the constant is the same.
    """

    constant: int
    lowest: int | None
    ratio: float


def level_of(equation: Equation) -> Level | None:
    """None where the equation is not as true of y - first: without a constant of its own that is unknown, or with what
    stood in the plant at the start."""
    unknown = [(term.signal, term.derivative) for term in equation.unknown]
    known = {term.signal for term in equation.known}
    if ("constant", 0) not in unknown or "constant" in known or any(signal == "start" for signal, _ in unknown):
        return None
    if any((term.signal, term.derivative) == ("process_output", 0) for term in equation.known):
        return None
    if not any(signal == "process_output" for signal, _ in unknown):
        return None
    constant = unknown.index(("constant", 0))
    if ("process_output", 0) not in unknown:
        return Level(constant, None, 0.0)
    lowest = unknown.index(("process_output", 0))
    ratio = -equation.unknown[lowest].coefficient / equation.unknown[constant].coefficient
    return Level(constant, lowest, ratio)
