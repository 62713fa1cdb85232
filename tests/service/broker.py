"""A Mosquitto of its own for a test: on a free port of the loopback, its files in a folder of the test."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from pmfid.service.broker import BrokerSection

MOSQUITTO = shutil.which(
    "mosquitto", path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
)
MISSING = "" if MOSQUITTO else "not installed: mosquitto (make service-tools INSTALL_TOOLS=1)"
needs_broker = pytest.mark.skipif(bool(MISSING), reason=MISSING)

CONFIG = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence true
persistence_location {folder}/
autosave_interval 1
log_dest none
{user}
"""


#: All that a test has started.
_STARTED: list[Broker] = []


@pytest.fixture
def stopped_brokers() -> Iterator[None]:
    """Whatever a test does, no broker of it goes on."""
    before = len(_STARTED)
    yield
    while len(_STARTED) > before:
        _STARTED.pop().stop()


@dataclass
class Broker:
    """folder: of its configuration and what it keeps; more: lines of its configuration."""

    folder: Path
    more: str = "max_queued_messages 100000\n"
    port: int = 0
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if not self.port:
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                self.port = free.getsockname()[1]

    @property
    def section(self) -> BrokerSection:
        return BrokerSection(host="127.0.0.1", port=self.port)

    def start(self) -> Broker:
        """Starts it, as it was left, and waits until it takes connections."""
        user = "user root" if os.geteuid() == 0 else ""  # else it gives up the right to its own folder
        config = self.folder / "mosquitto.conf"
        config.write_text(CONFIG.format(port=self.port, folder=self.folder, user=user) + self.more)
        self._process = subprocess.Popen([str(MOSQUITTO), "-c", config], stderr=subprocess.DEVNULL)
        _STARTED.append(self)
        for _ in range(500):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return self
            if self._process.poll() is not None:
                break
            time.sleep(0.02)
        raise RuntimeError("Mosquitto does not start")

    def kill(self) -> None:
        """Ends it without a warning; only what it saved by itself stays."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self._process = None

    def stop(self) -> None:
        """Ends it if it runs."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()
            self._process = None
