"""How many axes a service bears: machines, broker and `pmfid serve` on one computer.

python -m studies.service.load --axes 10000 --seconds 600
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from studies.service.machines import DT, SAMPLES, write_plant
from studies.service.processes import Service, Use, broker, free_port, service, use_of

#: Seconds between two looks.
LOOK = 5.0
PAGE = """
[page]
port = {port}
token_env = "PMFID_TOKEN"
"""


def measure(axes: int, seconds: float, state: bool = True) -> dict[str, object]:
    """One load: what came through, what each process used, how late the estimates were."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with broker(folder) as (port, broker_pid):
            plant = write_plant(folder, axes, port, 'state = "state"\ncheckpoint = 10.0\nevery = 1.0' if state else "")
            plant.write_text(plant.read_text() + PAGE.format(port=free_port()))
            with service(plant, folder / "log.jsonl") as served:
                found = _watched(served, broker_pid, port, axes, seconds)
                found["log"] = (folder / "log.jsonl").read_text()[-2000:]
    return found


def _watched(served: Service, broker_pid: int, port: int, axes: int, seconds: float) -> dict[str, object]:
    command = [sys.executable, "-m", "studies.service.machines", "--port", str(port)]
    command += ["--axes", str(axes), "--seconds", str(seconds)]
    pids = {"service": served.process.pid, "broker": broker_pid}
    before = {name: use_of(pid) for name, pid in pids.items()}
    machines = subprocess.Popen(command, stdout=subprocess.PIPE)
    pids["machines"], before["machines"] = machines.pid, Use(0, 0, 0)
    begin, looks = time.monotonic(), list[dict[str, float]]()
    used = dict[str, Use]()
    while machines.poll() is None:
        time.sleep(LOOK)
        looks.append(_look(served, begin))
        for who, pid in pids.items():
            if who != "machines" or machines.poll() is None:
                used[who] = use_of(pid)
    sent = json.loads(machines.communicate()[0])
    _drained(served, sent["samples"])
    looks.append(_look(served, begin))
    wall = sent["wall"]
    cores = {who: (used[who].cpu - before[who].cpu) / wall for who in used}
    return {"axes": axes, "rate": 1 / DT, "block": SAMPLES, "sent": sent, "looks": looks, "cores": cores}


def _drained(served: Service, samples: float) -> None:
    """Waits until all is through, but not for ever."""
    before = -1.0
    while (now := served.total("pmfid_samples_total")) < samples and now > before:
        before = now
        time.sleep(3.0)


def _look(served: Service, begin: float) -> dict[str, float]:
    metrics, use = served.metrics(), use_of(served.process.pid)
    total = {
        name: served.total(f"pmfid_{name}", metrics)
        for name in ("samples_total", "samples_dropped_total", "samples_missing_total", "dropped_rows_total")
    }
    slow = {name: value for name, value in metrics.items() if name.startswith("pmfid_latency")}
    return {"t": time.monotonic() - begin, "memory": use.memory, "files": use.files, **total, **slow}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args()
    json.dump(measure(options.axes, options.seconds), sys.stdout, indent=1)


if __name__ == "__main__":
    main()
