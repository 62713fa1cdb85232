"""Processes of tests, which end with the block that started them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Timer
from typing import Any


@contextmanager
def run_process(command: Sequence[object], limit: float = 120.0, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start the process of a command and kill it at the end of the block, or after `limit` seconds.

    After the limit, a test that waits for the output reads the end of the file.
    """
    with subprocess.Popen([*map(str, command)], **options) as process:
        timer = Timer(limit, process.kill)
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            process.kill()
