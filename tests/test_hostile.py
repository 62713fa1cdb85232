"""Random calls of every command, valid and broken: no traceback, no warning, no number that is not finite."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import long_unless
from tests.hostile.commands import COMMANDS, Case
from tests.hostile.plants import PLANTS, Columns
from tests.hostile.records import as_csv
from tests.hostile.verdict import judge, run

CASES, GROUP = 400, 10
ROTARY = """
[record]
input = "u"
output = "y"
time = "t"
[encoder]
resolution = 0.003
[model]
input_gain = 0.05
[estimator]
cutoff = 100.0
"""
PROCESS = """
[record]
input = "u"
output = "y"
time = "t"
reference = "r"
[model]
kind = "transfer_function"
n = 2
m = 0
[estimator]
cutoff = 3.0
"""


@pytest.mark.parametrize("start", long_unless((0, 10, 20).__contains__, range(0, CASES, GROUP)))
def test_every_call_ends_as_the_pages_promise(start: int) -> None:
    faults = {seed: verdict.faults for seed in range(start, start + GROUP) if (verdict := judge(seed)).faults}
    assert not faults


def test_every_command_is_called() -> None:
    from pmfid.cli.main import main

    assert set(main.commands) | {"none"} == set(COMMANDS)
    assert sum(maker.part for maker in COMMANDS.values()) == pytest.approx(1)


def called(folder: Path, command: str, plant: str, axis: str, *further: str, **columns: np.ndarray) -> tuple[str, ...]:
    record: Columns = PLANTS[plant](0)[0] | columns
    files = {"axis.toml": axis.encode(), "run.csv": as_csv(np.random.default_rng(0), record)}
    return run(Case((command, "run.csv", "--config", "axis.toml", "--json", *further), files), folder).faults


def test_calls_that_ended_in_a_traceback(tmp_path: Path) -> None:
    """The calls are a method for processes on a drive, a reference of 1e200, and a cutoff of 1e-320."""
    assert called(tmp_path, "identify", "rotary", ROTARY + 'method = "srivc"\n', "--method", "all") == ()
    assert called(tmp_path, "identify", "process", PROCESS, r=np.full(120, 1e200)) == ()
    assert called(tmp_path, "identify", "rotary", ROTARY.replace("100.0", "1e-320") + 'method = "rls"') == ()
