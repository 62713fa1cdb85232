"""Messages of Spark and its processes go to a file next to a checkpoint; a failure becomes one sentence."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from pmfid.fleet.tuning import TUNING

__all__ = ["SparkLog"]

NAME = "spark.log"
#: A line that names the cause of a failure, in Python or Java.
CAUSE = re.compile(r"(Caused by: )?[\w.$]+(Error|Exception): .")
#: What Spark says of a checkpoint that is not whole.
DAMAGED = ("log file", "end-of-input", "CANNOT_LOAD_STATE_STORE", "ChecksumException")
REPAIR = "the checkpoint is damaged: put back a copy of it, or give new folders for --checkpoint and --out"
AGAIN = "mend that, and start it again"
NO_MEMORY = (
    "the stream stopped: Java has no memory left; start it again where there is more, or with the variable "
    "SPARK_DRIVER_MEMORY=8g for 8 GB; in a session of your own raise spark.driver.memory"
)


class SparkLog:
    """Of a process that uses the checkpoint in `folder`."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self._begun = self.path.stat().st_size if self.path.exists() else 0

    @contextmanager
    def capture(self) -> Iterator[None]:
        """Redirects the messages of a Java process started meanwhile to the log, for its whole life. The messages are
        many, and help to find the cause of a failure."""
        sys.stderr.flush()
        kept = os.dup(2)
        with self._open_log() as log:
            os.dup2(log.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)

    def _open_log(self) -> IO[bytes]:
        """The log, opened to append; the null device if the checkpoint can only be read."""
        try:
            return open(self.path, "ab")
        except OSError:
            return open(os.devnull, "ab")

    def problem(self, error: Exception) -> str:
        """What Spark says of a failure, without its traces."""
        if "java.lang.OutOfMemoryError" in self._read_messages():
            return NO_MEMORY
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        causes = [line for line in lines if CAUSE.match(line)]
        cause = causes[-1] if causes else next(iter(lines), "without a reason given")
        damaged = any(sign in str(error) for sign in DAMAGED)
        return f"the stream stopped: {cause[:400]}; {REPAIR if damaged else AGAIN} ({self.path} has more)"

    def _read_messages(self) -> str:
        with suppress(OSError), open(self.path, "rb") as file:
            file.seek(max(self._begun, file.seek(0, os.SEEK_END) - TUNING.log_lately))
            return file.read().decode("utf-8", "replace")
        return ""
