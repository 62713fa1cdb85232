"""A hundred random configurations and records, broken and not: no traceback, no warning, no number that is not finite.

`python -m tests.hostile.study` tries 2000.
"""

from __future__ import annotations

import pytest

from tests.hostile.verdict import judge

CASES, GROUP = 100, 10


@pytest.mark.parametrize("start", range(0, CASES, GROUP))
def test_every_case_ends_as_the_pages_promise(start: int) -> None:
    faults = {seed: verdict.faults for seed in range(start, start + GROUP) if (verdict := judge(seed)).faults}
    assert not faults


@pytest.mark.parametrize("seed", [216, 1081, 1668])
def test_cases_that_ended_in_a_traceback(seed: int) -> None:
    """A drive by a method for processes compared, a reference of 1e200, a cutoff of 1e-320."""
    assert judge(seed).faults == ()
