"""Kills of the service; `make kills` does a thousand of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.parametrize("what", ["", pytest.param(" --edges", marks=pytest.mark.long)])
def test_a_service_that_is_killed_ends_as_one_that_was_not(what: str) -> None:
    words = f"-m tests.service.kill_campaign --kills 4 --round 4 --seconds 6 --seed 7{what}"
    done = subprocess.run([sys.executable, *words.split()], cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "4 kills" in done.stdout
    assert "every state and row as without kills" in done.stdout
