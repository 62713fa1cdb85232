"""A process that was stopped and goes on reports the pause."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.processes import run_process
from tests.service.kills import REPOSITORY
from tests.service.test_serve import PLANT, folder  # noqa: F401 a fixture

#: Run `pmfid serve` with a threshold of half a second for a pause.
PROGRAM = """
import sys
import pytest
from tests.tuned import set_tuning
from pmfid.pipeline.monitored import setup
set_tuning(pytest.MonkeyPatch(), "pmfid.service.tuning", process_stood=0.5)
setup.HOURS = 0.5
from pmfid.cli.main import main
main(["serve", sys.argv[1], "--json"])
"""


def test_a_process_that_was_stopped_says_for_how_long(folder: Path) -> None:  # noqa: F811
    plant = folder / "paused.toml"
    plant.write_text(PLANT)
    command = [sys.executable, "-c", PROGRAM, plant]
    pipe = (folder / "run.csv").open()
    with pipe, run_process(command, cwd=REPOSITORY, stdin=pipe, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        reported = (json.loads(line) for line in process.stdout)
        assert any(one["event"] == "alarm" for one in reported), "it works"
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(process.pid, signal.SIGCONT)
        paused = next(one for one in reported if one["event"] == "paused" and one["seconds"] > 0.9)
        os.kill(process.pid, signal.SIGTERM)
        assert [one["event"] for one in reported][-1] == "ended"
    assert "stopped" in paused["problem"]
