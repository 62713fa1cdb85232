"""Processes of tests, which end with the block that started them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Timer
from typing import Any


@contextmanager
def run_process(command: Sequence[object], limit: float = 120.0, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """The process of a command. It is killed at the end of the block and after `limit` seconds; a test that waits for
    its output then reads the end of the file."""
    with subprocess.Popen([*map(str, command)], **options) as process:
        timer = Timer(limit, process.kill)
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            process.kill()
