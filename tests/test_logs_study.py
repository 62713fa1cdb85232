"""The study of logs on some of them, and its conditions on a remedy."""

from __future__ import annotations

import numpy as np
import pytest

from studies.log_folder import logs
from studies.logs import SAME, Outcome, outcomes
from tests.conftest import unjudged

#: One log of each part of the folder; two of them have a remedy.
CHOSEN = ("format .mcap", "row of units", "time in us, unsaid", "50 lines missing", "TDMS, mA, deg and wrap")


@pytest.fixture(scope="module")
def found() -> dict[str, Outcome]:
    with unjudged():
        return {log.name: result for log, result in outcomes([log for log in logs() if log.name in CHOSEN])}


@pytest.mark.parametrize("name", CHOSEN)
def test_a_log_becomes_what_the_clean_one_is(found: dict[str, Outcome], name: str) -> None:
    assert found[name].error is not None
    # the motion starts again after each input that was lost, which costs information
    assert found[name].error < (2 * SAME if name == "50 lines missing" else SAME)
    assert (found[name].followed == ('time_unit = "us"',)) == (name == "time in us, unsaid")


def test_the_folder_has_every_variant_once() -> None:
    names = [log.name for log in logs()]
    assert len(names) == len(set(names)) >= 40
    assert {log.bench for log in logs()} == {"rotary", "linear"}


def test_what_is_off_is_wrong_and_what_has_no_remedy_refused() -> None:
    assert Outcome(0.006, (), ()).verdict == "WRONG"
    assert Outcome(None, ("no",), ()).verdict == "refused"
    assert Outcome(float(np.float64(0.001)), ("ms",), ('time_unit = "ms"',)).verdict == "same"
