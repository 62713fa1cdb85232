"""Figures of merit of an estimate over many runs: how far off, how much scatter, how honest the error bars."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Of a normal variable: 95 % lie within.
QUANTILE = 1.96


@dataclass(frozen=True)
class Score:
    """One run. error: mean of (estimate/truth - 1) over its samples; square: mean of its square; covered: part of
    the samples whose 95 % interval holds the truth; settled [s]: when the estimate came to stay near the truth,
    inf: never, nan: not asked; information: of the input, nan: not asked. All nan but the last two: no estimate."""

    error: float
    square: float
    covered: float
    settled: float = math.nan
    information: float = math.nan


NO_ANSWER = Score(math.nan, math.nan, math.nan)


def score(
    values: Floats, std: Floats, truth: Floats | float, settled: float = math.nan, information: float = math.nan
) -> Score:
    """The score of a run with estimates and standard deviations (n,) of one parameter."""
    error = values / truth - 1
    covered = np.abs(values - truth) < QUANTILE * std
    return Score(float(error.mean()), float(np.mean(error**2)), float(covered.mean()), settled, information)


@dataclass(frozen=True)
class Merit:
    """A row of the table. figure; condition: of the runs; method; increments: of the encoder; runs, and those
    `refused` without an estimate; of the mass: bias, std about it, rms and coverage of the 95 % intervals [%];
    settled: median time to come to stay near the truth [s], inf: never in half of the runs; information: Fisher
    information of the input on the mass [1/kg^2], mean; nan where it does not apply."""

    figure: str
    condition: str
    method: str
    increments: int
    runs: int
    refused: int
    bias: float
    std: float
    rms: float
    coverage: float
    settled: float
    information: float


def merit(figure: str, condition: str, method: str, increments: int, scores: Sequence[Score]) -> Merit:
    """The row of so many runs, all with the same number of samples."""
    answered = [s for s in scores if not math.isnan(s.error)]
    bias, square, covered = np.mean([(s.error, s.square, s.covered) for s in answered] or [(math.nan,) * 3], axis=0)
    information = float(np.mean([s.information for s in answered] or [math.nan]))
    return Merit(
        figure,
        condition,
        method,
        increments,
        len(scores),
        len(scores) - len(answered),
        100 * float(bias),
        100 * math.sqrt(max(0.0, square - bias**2)),
        100 * math.sqrt(square),
        100 * float(covered),
        _median([s.settled for s in answered]),
        information,
    )


def _median(times: Sequence[float]) -> float:
    """The median; inf where that many never came, nan where nobody asked."""
    ordered = sorted(times)
    if not ordered or math.isnan(ordered[0]):
        return math.nan
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


HEADER = (
    "figure",
    "condition",
    "method",
    "increments",
    "runs",
    "no answer",
    "bias [%]",
    "std [%]",
    "RMS [%]",
    "coverage [%]",
    "settled [s]",
    "information [1/kg²]",
)


def cells(row: Merit) -> list[str]:
    """The row as text, in the order of HEADER; "–" where a figure does not apply."""
    numbers = (("bias", "+.2f"), ("std", ".2f"), ("rms", ".2f"), ("coverage", ".1f"), ("settled", ".2f"))
    texts = [_text(getattr(row, name), form) for name, form in numbers]
    named = [row.figure, row.condition, row.method, str(row.increments), str(row.runs), str(row.refused)]
    return [*named, *texts, _text(row.information, ".3g")]


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else "never" if math.isinf(value) else f"{value:{form}}"


def write_table(rows: Sequence[Merit], path: Path) -> None:
    """The rows as CSV, all digits; empty where a figure does not apply. Raises OSError."""
    names = [field.name for field in fields(Merit)]
    lines = [",".join(names)]
    for row in rows:
        values = [getattr(row, name) for name in names]
        lines.append(
            ",".join(
                "" if isinstance(v, float) and math.isnan(v) else f'"{v}"' if "," in str(v) else f"{v}" for v in values
            )
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
