"""The table of the referee: one line for each kind of truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from pmfid.fit.compare import NORMAL_95
from pmfid.types import Flags, Floats
from studies.referee.cases import PARAMETERS
from studies.referee.judge import Row

#: An error is wrong beyond three standard errors and the tolerance of `identify` ([estimator] tolerance).
STANDARD_ERRORS, TOLERANCE = 3.0, 0.01

#: Growth of an error that counts as worse.
WORSE = 1.1


def column(rows: Sequence[Row], name: str) -> Floats:
    """Return the values (rows, 3) of a column of each parameter."""
    return np.array([[float(row[f"{parameter}_{name}"]) for parameter in PARAMETERS] for row in rows]).reshape(-1, 3)


def find_wrong(error: Floats, std: Floats) -> Flags:
    """Return whether any parameter (rows, 3) is beyond three standard errors and the tolerance."""
    return np.asarray((np.abs(error) > np.fmax(STANDARD_ERRORS * std, TOLERANCE)).any(axis=1))


def summarise(kind: str, rows: Sequence[Row]) -> Row:
    """Return the line of a kind. Errors and the refusals are in percent; `refused`, `silent` and so on count runs.

    silent: an empty status, and an error beyond three printed standard errors and the tolerance; silent_wide: beyond
    3 / 1.96 half lengths of the interval. covered: runs in percent whose interval holds the parameter. length: root
    mean square of the half lengths over 1.96 root mean square errors; typical_length: 0.344 over the median of error
    over half length, so that both are 1 for exact normal intervals.
    """
    results = [row for row in rows if not row["refused"]]
    error, std, low, high = (column(results, name) for name in ("error", "std", "low", "high"))
    half, empty = np.maximum(error - low, high - error), np.array([not row["status"] for row in results], bool)
    seconds = np.array([float(row["seconds"]) for row in rows])
    reasons = Counter(str(row["refused"]).partition(":")[0] for row in rows if row["refused"])
    line: Row = {
        "kind": kind,
        "runs": len(rows),
        "refused": len(rows) - len(results),
        "refusals": ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items())),
        "empty": int(empty.sum()),
        "wrong": int(find_wrong(error, std).sum()),
        "silent": int((empty & find_wrong(error, std)).sum()),
        "silent_wide": int((empty & find_wrong(error, half / NORMAL_95)).sum()),
        "no_interval": int(np.isnan(half).any(axis=1).sum()),
        "seconds_median": float(np.median(seconds)),
        "seconds_most": float(seconds.max()),
    }
    for place, parameter in enumerate(PARAMETERS):
        line |= summarise_parameter(parameter, error[:, place], half[:, place], low[:, place], high[:, place])
    return line


def summarise_parameter(name: str, error: Floats, half: Floats, low: Floats, high: Floats) -> Row:
    """Return the cells of one parameter. The arrays (runs,) are relative to the truth."""
    given = np.isfinite(half)
    size, length = np.abs(error), np.nan
    typical = covered = length
    if given.any():
        length = float(np.sqrt(np.mean(half[given] ** 2) / np.mean(size[given] ** 2))) / NORMAL_95
        typical = 0.6745 / NORMAL_95 / float(np.median(size[given] / half[given]))
        covered = 100 * float(np.mean((low[given] <= 0) & (high[given] >= 0)))
    return {
        f"{name}_median": 100 * float(np.median(size)) if size.size else np.nan,
        f"{name}_most": 100 * float(np.max(size)) if size.size else np.nan,
        f"{name}_half": 100 * float(np.median(half[given])) if given.any() else np.nan,
        f"{name}_covered": covered,
        f"{name}_length": length,
        f"{name}_typical_length": typical,
    }


def tabulate(rows: Sequence[Row]) -> list[Row]:
    """Return a line for each kind, for all wrong models together, and for each motion of the right model."""
    kinds = list(dict.fromkeys(str(row["kind"]) for row in rows))
    lines = [summarise(kind, [row for row in rows if row["kind"] == kind]) for kind in kinds]
    wrong = [row for row in rows if row["kind"] != "right"]
    right = [row for row in rows if row["kind"] == "right"]
    if len(kinds) > 2:
        lines.append(summarise("all wrong", wrong))
    motions = sorted({str(row["motion"]) for row in right})
    return lines + [summarise(f"right, {m}", [row for row in right if row["motion"] == m]) for m in motions]


INTRODUCTION = """\
# Referee

`python -m studies.referee --seed {seed}` wrote this page, its table and a row for each machine as CSV. The machines are
random, and an independent integrator simulates them. Each fit gets one record, the input gain and the encoder, and
assumes a plain drive. The three numbers in a cell belong to mass, viscous friction and Coulomb friction.

- empty: runs without a status word. Wrong: runs with an error beyond three standard errors and 1 %.
- silent: wrong runs without a status word. Silent, wide: the same, with the standard error of the 95 % interval.
- error, most: median and largest error in percent. Half: median half length of the 95 % interval in percent.
- holds: runs in percent whose interval contains the true value.
- length: root mean square of the half lengths, over 1.96 root mean square errors.
- typical: the same from medians. An exact normal interval has the value 1 in both columns.

"""


def write_number(value: float) -> str:
    """Return a number with two digits, without an exponent."""
    return f"{value:.0f}" if value >= 10 else "<0.0001" if value < 1e-4 else f"{value:.2g}"


def compare(lines: Sequence[Row], before: Sequence[Row]) -> list[str]:
    """Return the cells whose median or largest error is more than 1.1 times the error in the table `before`."""
    former = {str(line["kind"]): line for line in before}
    return [
        f"{line['kind']}: {name} {what} {float(line[key]):.3g} %, before {float(former[str(line['kind'])][key]):.3g} %"
        for line in lines
        if line["kind"] in former
        for name in PARAMETERS
        for what in ("median", "most")
        if float(line[key := f"{name}_{what}"]) > WORSE * float(former[str(line["kind"])][key])
    ]


def write_page(lines: Sequence[Row], seed: int) -> str:
    """Return the page for readers."""
    whole = {"runs": "runs", "refused": "refused", "empty": "empty", "wrong": "wrong", "silent": "silent"}
    whole |= {"silent_wide": "silent, wide"}
    triples = {"median": "error", "most": "most", "half": "half", "covered": "holds", "length": "length"}
    triples |= {"typical_length": "typical"}
    text = [["truth", *whole.values(), *triples.values(), "CPU [s]"]]
    text.append(["---"] * len(text[0]))
    for line in lines:
        cells = [" / ".join(write_number(float(line[f"{name}_{what}"])) for name in PARAMETERS) for what in triples]
        text.append([str(line["kind"]), *(str(line[name]) for name in whole), *cells, f"{line['seconds_median']:.2g}"])
    return (
        INTRODUCTION.format(seed=seed)
        + "\n".join(f"| {' | '.join(cells)} |".replace("nan", "–") for cells in text)
        + "\n"
    )
