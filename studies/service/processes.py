"""A broker, a service and machines as separate processes, with their use of the system."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pmfid.errors import UsageError

#: Longest start of a process [s], with the calibration of a service.
STARTING = 600.0
#: Longest time for an answer of the page [s]: a service that was stopped for a minute continues after it.
ANSWERING = 180.0
TICKS, PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
BROKER = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence false
max_inflight_messages 0
max_queued_messages 0
set_tcp_nodelay true
"""


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@dataclass(frozen=True)
class Use:
    """The use of a process: processor time [s], resident memory [MB], and open files."""

    cpu: float
    memory: float
    files: int


def use_of(pid: int) -> Use:
    """Return the use of a running process."""
    place = Path("/proc") / str(pid)
    fields = (place / "stat").read_text().rpartition(")")[2].split()
    memory = int((place / "statm").read_text().split()[1]) * PAGE / 1e6
    return Use((int(fields[11]) + int(fields[12])) / TICKS, memory, len(list((place / "fd").iterdir())))


@contextmanager
def broker(folder: Path, limits: str = BROKER) -> Iterator[tuple[int, int]]:
    """Start Mosquitto with the configuration `limits` on a free local port; yield port and process number."""
    import shutil

    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if program is None:
        raise UsageError("mosquitto is not installed; on Debian: apt-get install mosquitto")
    port = free_port()
    (folder / "mosquitto.conf").write_text(limits.format(port=port))
    process = subprocess.Popen([program, "-c", folder / "mosquitto.conf"], stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: _listens(port), process)
        yield port, process.pid
    finally:
        process.terminate()
        process.wait(30)


def _listens(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


def wait_until(there: object, process: subprocess.Popen[bytes]) -> None:
    begin = time.monotonic()
    while not there():  # type: ignore[operator]
        if process.poll() is not None or time.monotonic() > begin + STARTING:
            raise UsageError(f"{process.args!r} did not start")
        time.sleep(0.1)


@dataclass(frozen=True)
class Service:
    """A running service, with the port of its page and the token that opens it."""

    process: subprocess.Popen[bytes]
    port: int
    token: str

    def get(self, path: str) -> str:
        """Return the answer of the page."""
        address = f"http://127.0.0.1:{self.port}{path}"
        request = urllib.request.Request(address, headers={"Authorization": f"Bearer {self.token}"})
        with urllib.request.urlopen(request, timeout=ANSWERING) as answer:
            return str(answer.read().decode())

    def metrics(self) -> dict[str, float]:
        """Return the values of `/metrics`, with the labels in the names."""
        lines = (line for line in self.get("/metrics").splitlines() if line and not line.startswith("#"))
        return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines)}

    def total(self, name: str, metrics: dict[str, float] | None = None) -> float:
        """Return the sum of a metric over all its labels."""
        found = self.metrics() if metrics is None else metrics
        return sum(value for key, value in found.items() if re.fullmatch(rf"{name}(\{{.*\}})?", key))


@contextmanager
def service(plant: Path, log: Path) -> Iterator[Service]:
    """Run `pmfid serve` on a plant whose page has `token = "env:PMFID_TOKEN"` and a fixed port."""
    token = "0123456789abcdefghijklmn"
    port = int(re.findall(r"^port = (\d+)$", plant.read_text(), re.MULTILINE)[-1])
    environment = os.environ | {"PMFID_TOKEN": token, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with log.open("wb") as out:
        command = [str(Path(sys.executable).with_name("pmfid")), "serve", str(plant), "--json"]
        process = subprocess.Popen(command, stdout=out, stderr=out, env=environment)
    try:
        wait_until(lambda: _listens(port), process)
        yield Service(process, port, token)
    finally:
        process.terminate()
        process.wait(120)
