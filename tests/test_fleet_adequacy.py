"""The judge decides whether the model describes an axis and whether the moves suffice.

The segments are given numbers, or motion of an integrator that is not the package's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.fleet.series import (
    Periods,
    Series,
    period_rows,
    standing,
)
from pmfid.fleet.verdicts import CHANGED, follow_axis, judge_axes
from pmfid.status import Status
from pmfid.types import Floats
from tests.test_fleet_changes import NAMES, series

N = 40
THETA = np.array([64.0, 10.0, 2.5])


def seen(rng: np.random.Generator, status: np.ndarray, factors: Floats | float = 1.0, bar: float = 0.005) -> Series:
    """Return segments with their status (N,), and parameters scaled by factors (N, 3)."""
    std = np.full((N, 3), bar) * THETA
    return replace(series(THETA * factors + std * rng.standard_normal((N, 3)), std), status=status.astype(np.uint32))


def qualities(one: Series) -> list[object]:
    rows = period_rows("a", "", one, NAMES, Periods.from_name("1min"), 60.0, ())
    return [row["quality"] for row in rows]


@pytest.mark.parametrize(("bit", "every"), [(Status.UNMODELLED, 10), (Status.DEAD_TIME, 4), (Status.FEEDBACK, 4)])
def test_an_equation_that_is_off_in_some_moves_is_off_in_all_periods(bit: Status, every: int) -> None:
    status = np.zeros(N, np.int64)
    status[::every] = bit
    one = seen(np.random.default_rng(0), status)
    assert standing(one) == {bit.name.lower()}  # type: ignore[union-attr]
    assert qualities(one) == ["doubt"] * N
    status[2 * every :] = 0  # a change of a parameter leaves this status
    assert qualities(seen(np.random.default_rng(0), status)).count("good") == N - 2


def test_a_step_of_what_would_be_seen_is_seen() -> None:
    found = 0
    for seed in range(20):
        rng = np.random.default_rng([4, seed])
        bar = 0.01
        quiet = judge_axes([follow_axis("a", "", seen(rng, np.zeros(N, np.int64), bar=bar), NAMES, 0.02)], NAMES, 0.02)[
            0
        ]
        factors = np.ones((N, 3))
        factors[N // 2 :, 0] += 1.2 * quiet.visible
        stepped = seen(rng, np.zeros(N, np.int64), factors, bar)
        found += judge_axes([follow_axis("a", "", stepped, NAMES, 0.02)], NAMES, 0.02)[0].kind == CHANGED
    assert found >= 18
