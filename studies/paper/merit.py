"""Figures of merit of an estimate over many runs: bias, scatter, and coverage of the error bars."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from pmfid.types import Floats

#: Quantile of a normal variable for 95 %.
QUANTILE = 1.96


@dataclass(frozen=True)
class Score:
    """The score of one run.

    `error` is the mean of (estimate/truth - 1) over its samples, and `square` the mean of its square. `covered` is the
    fraction of samples whose 95 % interval holds the truth. `settled` is the time [s] after which the estimate stays
    near the truth (inf: never, nan: not measured). `information` belongs to the input (nan: not measured). Without an
    estimate the first three are nan.
    """

    error: float
    square: float
    covered: float
    settled: float = math.nan


NO_ANSWER = Score(math.nan, math.nan, math.nan)


def score(values: Floats, std: Floats, truth: float, settled: float = math.nan) -> Score:
    """Return the score of a run with estimates and standard deviations (n,) of one parameter."""
    error = values / truth - 1
    covered = np.abs(values - truth) < QUANTILE * std
    return Score(float(error.mean()), float(np.mean(error**2)), float(covered.mean()), settled)


@dataclass(frozen=True)
class Merit:
    """A row of the table.

    `condition` describes the runs, `increments` the encoder, and `refused` counts runs without an estimate. bias, std,
    rms and coverage of the 95 % intervals belong to the mass [%]. `settled` is the median time to stay near the truth
    [s]; inf means never in half of the runs. `information` is the Fisher information of the input on the mass with
    known friction (paper eq. 40), and `joint` with unknown friction [1/kg^2]. `loss` is the part of the information
    that a design loses by a wrong mass [%], and `terminal` the error of the design's end [mm]. nan means that a figure
    does not apply.
    """

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
    """Return the row of runs that all have the same number of samples."""
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
    """Return the median of the times: inf if most runs never settle, and nan without a measurement."""
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
    """Return the row as text, in the order of HEADER; "–" means that a figure does not apply."""
    named = [row.figure, row.condition, row.method, str(row.increments), str(row.runs), str(row.refused)]
    return [*named, *(_text(getattr(row, name), form) for name, form in _FORMS.items())]


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else "never" if math.isinf(value) else f"{value:{form}}"


def write_table(rows: Sequence[Merit], path: Path) -> None:
    """Write the rows as CSV with all digits, empty if a figure does not apply. Raises OSError."""
    names = [field.name for field in fields(Merit)]
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            writer.writerow("" if value != value else value for value in (getattr(row, name) for name in names))
