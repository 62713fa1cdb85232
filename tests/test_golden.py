"""Every method computes its kept outputs; `make golden` writes new outputs, whose diff shows the changes."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from pmfid.simulation import SCENARIOS
from tests.golden.make import DIGITS_OFF_LINE, HEADER, INCREMENTS, PLACE, rows

#: Each scenario with one of the encoders by turns, and all processes; all other cases would double the time.
OFTEN = {f"{name} {INCREMENTS[k % len(INCREMENTS)]}" for k, name in enumerate(SCENARIOS)}


def is_often(record: str) -> bool:
    return record in OFTEN or record.startswith("process ")


@pytest.mark.parametrize("often", [True, pytest.param(False, marks=pytest.mark.long)])
def test_outputs_are_those_of_the_file(often: bool) -> None:
    with PLACE.open(encoding="utf-8", newline="") as file:
        header, *whole = csv.reader(file)
    assert tuple(header) == HEADER
    kept = [row for row in whole if is_often(row[0]) == often]
    computed = list(rows(lambda record: is_often(record) == often))
    assert [tuple(row[:4]) for row in kept] == [row[:4] for row in computed]
    for before, now in zip(kept, computed, strict=True):
        assert _close(before[4:], now[4:], before[1]), (before, now)


def _close(before: list[str], now: tuple[str, ...], method: str) -> bool:
    """Compare as text. Allow the rounding of a library's order of addition for methods that use its linear algebra."""
    if before == list(now):
        return True
    values = [np.array(" ".join(part).split(), float) for part in (before, now)]
    tolerance = 100 * 10.0**-DIGITS_OFF_LINE
    exact = method == "bcrls" or method.startswith("r")
    return not exact and np.allclose(*values, rtol=tolerance, atol=tolerance)
