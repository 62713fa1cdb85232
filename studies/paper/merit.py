"""Figures of merit of an estimate over many runs: how far off, how much scatter, how honest the error bars."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from pmfid.types import Floats

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


NO_ANSWER = Score(math.nan, math.nan, math.nan)


def score(values: Floats, std: Floats, truth: float, settled: float = math.nan) -> Score:
    """The score of a run with estimates and standard deviations (n,) of one parameter."""
    error = values / truth - 1
    covered = np.abs(values - truth) < QUANTILE * std
    return Score(float(error.mean()), float(np.mean(error**2)), float(covered.mean()), settled)


@dataclass(frozen=True)
class Merit:
    """A row of the table. figure; condition: of the runs; method; increments: of the encoder; runs, and those
    `refused` without an estimate; of the mass: bias, std about it, rms and coverage of the 95 % intervals [%];
    settled: median time to come to stay near the truth [s], inf: never in half of the runs; information: Fisher
    information of the input on the mass with friction known (paper eq. 40) and `joint`: with friction unknown as well
    [1/kg^2]; loss: what of the former a design loses for a wrong mass [%]; terminal: by how much it then misses its end
    [mm]; nan where it does not apply."""

    figure: str
    condition: str
    method: str
    increments: int
    runs: int
    refused: int = 0
    bias: float = math.nan
    std: float = math.nan
    rms: float = math.nan
    coverage: float = math.nan
    settled: float = math.nan
    information: float = math.nan
    joint: float = math.nan
    loss: float = math.nan
    terminal: float = math.nan


def merit(figure: str, condition: str, method: str, increments: int, scores: Sequence[Score]) -> Merit:
    """The row of N runs, all with the same number of samples."""
    answered = [s for s in scores if not math.isnan(s.error)]
    bias, square, covered = np.mean([(s.error, s.square, s.covered) for s in answered] or [(math.nan,) * 3], axis=0)
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
    "joint information [1/kg²]",
    "loss [%]",
    "terminal [mm]",
)
_FORMS = {
    "bias": "+.2f",
    "std": ".2f",
    "rms": ".2f",
    "coverage": ".1f",
    "settled": ".2f",
    "information": ".3g",
    "joint": ".3g",
    "loss": "+.1f",
    "terminal": "+.2f",
}


def cells(row: Merit) -> list[str]:
    """The row as text, in the order of HEADER; "–" where a figure does not apply."""
    named = [row.figure, row.condition, row.method, str(row.increments), str(row.runs), str(row.refused)]
    return [*named, *(_text(getattr(row, name), form) for name, form in _FORMS.items())]


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else "never" if math.isinf(value) else f"{value:{form}}"


def write_table(rows: Sequence[Merit], path: Path) -> None:
    """The rows as CSV, all digits; empty where a figure does not apply. Raises OSError."""
    names = [field.name for field in fields(Merit)]
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            writer.writerow("" if value != value else value for value in (getattr(row, name) for name in names))
