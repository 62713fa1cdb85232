"""Kill a process in the middle of its work, for tests of the data that survive."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.processes import run_process

REPOSITORY = Path(__file__).parents[2]


def killed_after(program: str, lines: int, *arguments: str) -> list[str]:
    """Run Python code, kill it without notice after some lines of output, and return all lines that it wrote."""
    command = [sys.executable, "-c", program, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with run_process(command, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY, env=environment) as process:
        assert process.stdout is not None
        said = [process.stdout.readline().strip() for _ in range(lines)]
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read().split("\n")[:-1]
    assert process.returncode == -signal.SIGKILL, said
    return said + rest
