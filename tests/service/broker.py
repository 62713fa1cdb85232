"""A Mosquitto broker for one test: on a free port of the loopback, with its files in a folder of the test."""

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
from tests.patience import PATIENCE

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


#: All brokers that a test has started.
_STARTED: list[Broker] = []


@pytest.fixture
def stopped_brokers() -> Iterator[None]:
    """Stop the brokers of a test at its end, even if it fails."""
    before = len(_STARTED)
    yield
    while len(_STARTED) > before:
        _STARTED.pop().stop()


@dataclass
class Broker:
    """A broker with its folder for configuration and saved data; `more` are further lines of the configuration."""

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
        """Start the broker with its saved data and wait until it accepts connections."""
        user = "user root" if os.geteuid() == 0 else ""  # otherwise the broker gives up the right to its own folder
        config = self.folder / "mosquitto.conf"
        config.write_text(CONFIG.format(port=self.port, folder=self.folder, user=user) + self.more)
        self._process = subprocess.Popen([str(MOSQUITTO), "-c", config], stderr=subprocess.DEVNULL)
        _STARTED.append(self)
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return self
            if self._process.poll() is not None:
                break
            time.sleep(0.02)
        raise RuntimeError("Mosquitto does not start")

    def kill(self) -> None:
        """Kill the broker without a warning; only data that it saved by itself remain."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self._process = None

    def stop(self) -> None:
        """Stop the broker if it runs."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()
            self._process = None
