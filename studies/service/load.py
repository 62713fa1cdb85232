"""Measure how many axes a service can process, and for how long: machines, broker and `pmfid serve` on one computer.

python -m studies.service.load --out results/service_load.md --image results/images/service_load.png
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studies.service.machines import write_plant
from studies.service.processes import Service, Use, broker, free_port, service, use_of, wait_until

#: Seconds between two looks, and seconds at the beginning in which memory still grows.
LOOK, GROWING = 5.0, 60.0
PAGE = """
[page]
port = {port}
token = "env:PMFID_TOKEN"
"""
STATE = 'state = "state"\ncheckpoint = 10.0\nevery = 1.0'
TOTALS = ("samples_total", "samples_dropped_total", "samples_missing_total", "dropped_rows_total", "unusable_total")


@dataclass(frozen=True)
class Look:
    """A moment of a run: time [s], memory of the service [MB], open files, and totals by name.

    `slower` counts deliveries beyond each limit [s], and `deliveries` counts all so far.
    """

    time: float
    memory: float
    files: int
    totals: dict[str, float]
    slower: dict[float, float]
    deliveries: float


@dataclass(frozen=True)
class Run:
    """A run: requested axes and seconds, samples sent by the machines, and mean cores of each process."""

    axes: int
    seconds: float
    sent: dict[str, float]
    cores: dict[str, float]
    looks: list[Look]

    @property
    def late(self) -> dict[float, float]:
        """The fraction of the deliveries after the start whose estimates took longer than each limit [s]."""
        first = next((look for look in self.looks if look.time > GROWING), self.looks[0])
        last = self.looks[-1]
        n = max(1.0, last.deliveries - first.deliveries)
        return {limit: (number - first.slower.get(limit, 0.0)) / n for limit, number in last.slower.items()}

    @property
    def memory(self) -> tuple[float, float]:
        """The least and the most memory after the start [MB]."""
        kept = [look.memory for look in self.looks if look.time > GROWING] or [self.looks[-1].memory]
        return min(kept), max(kept)


def measure(axes: int, seconds: float) -> Run:
    """Measure one load."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with broker(folder) as (port, broker_pid):
            plant = write_plant(folder, axes, port, STATE)
            plant.write_text(plant.read_text() + PAGE.format(port=free_port()))
            with service(plant, folder / "log.jsonl") as served:
                return _watched(served, broker_pid, port, axes, seconds)


def _watched(served: Service, broker_pid: int, port: int, axes: int, seconds: float) -> Run:
    wait_until(lambda: served.total("pmfid_axes") >= axes, served.process)  # a service drops what comes before
    command = [sys.executable, "-m", "studies.service.machines", "--port", str(port)]
    command += ["--axes", str(axes), "--seconds", str(seconds)]
    pids = {"service": served.process.pid, "broker": broker_pid}
    before = {name: use_of(pid) for name, pid in pids.items()}
    machines = subprocess.Popen(command, stdout=subprocess.PIPE)
    pids["machines"], before["machines"] = machines.pid, Use(0, 0, 0)
    begin, looks, used = time.monotonic(), list[Look](), dict[str, Use]()
    while machines.poll() is None:
        time.sleep(LOOK)
        looks.append(_look(served, begin))
        used |= {who: use_of(pid) for who, pid in pids.items() if who != "machines" or machines.poll() is None}
    sent = json.loads(machines.communicate()[0])
    _drained(served, sent["samples"])
    used |= {who: use_of(pid) for who, pid in pids.items() if who != "machines"}  # with the work that came late
    looks.append(_look(served, begin))
    cores = {who: (used[who].cpu - before[who].cpu) / sent["wall"] for who in used}
    return Run(axes, seconds, sent, cores, looks)


def _drained(served: Service, samples: float) -> None:
    """Wait for a limited time until all samples are processed."""
    before = -1.0
    while (now := served.total("pmfid_samples_total")) < samples and now > before:
        before = now
        time.sleep(3.0)


def _look(served: Service, begin: float) -> Look:
    metrics, use = served.metrics(), use_of(served.process.pid)
    totals = {name: served.total(f"pmfid_{name}", metrics) for name in TOTALS}
    slower = {
        float(name.split('"')[1]): value
        for name, value in metrics.items()
        if name.startswith("pmfid_deliveries_slower_total")
    }
    deliveries = served.total("pmfid_deliveries_total", metrics)
    return Look(time.monotonic() - begin, use.memory, use.files, totals, slower, deliveries)


def row(run: Run) -> str:
    """Return a row of the table."""
    last, late = run.looks[-1].totals, run.late
    lost = run.sent["samples"] - last["samples_total"]
    p99 = next((f"{limit:g} s" for limit in sorted(late) if late[limit] <= 0.01), "more")
    cores = run.cores
    low, high = run.memory
    cells = [
        f"{run.axes}",
        f"{run.seconds:g}",
        f"{run.sent['samples'] / run.sent['wall'] / 1e6:.3f}",
        f"{lost:.0f}",
        f"{last['samples_dropped_total'] + last['samples_missing_total'] + last['dropped_rows_total']:.0f}",
        f"{cores['service']:.2f}, {cores['broker']:.2f}, {cores['machines']:.2f}",
        p99,
        f"{low:.0f} to {high:.0f}",
        f"{run.sent['late']:.2f}",
    ]
    return f"| {' | '.join(cells)} |"


HEAD = """# A service under load

Machines, Mosquitto and `pmfid serve` as processes of one computer with two processors. Every axis has 100 samples a
second, sent in blocks of 50, 50 axes in a message, at quality of service 1; the service keeps checkpoints every 10 s
and gives out an estimate per axis and second. Made by `python -m studies.service.load`.

""" + "".join(
    f"| {' | '.join(cells)} |\n"
    for cells in (
        (
            *("axes", "for [s]", "1e6 samples/s", "not arrived", "dropped, missing"),
            *("cores of service, broker, machines", "99 % of estimates within", "memory [MB]"),
            "sender late by at most [s]",
        ),
        ("---",) * 9,
    )
)
TAIL = """
*99 % of estimates within*: from a message's arrival at the service until its estimates are given out; the memory is
that after the first minute.

![Memory, open files and late estimates over time](images/{image})
"""


def write_figure(runs: list[Run], path: Path) -> None:
    """Draw memory, open files, and the fraction of late estimates over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
    for run in runs:
        t = [look.time for look in run.looks]
        label = f"{run.axes} axes"
        axes[0].plot(t, [look.memory for look in run.looks], label=label)
        axes[1].plot(t, [look.files for look in run.looks], label=label)
        slow = np.diff([0.0, *(look.slower.get(0.5, 0.0) for look in run.looks)])
        all_of_them = np.diff([0.0, *(look.deliveries for look in run.looks)])
        axes[2].plot(t, 100 * slow / np.maximum(all_of_them, 1), label=label)
    for one, text in zip(axes, ("memory [MB]", "open files", "estimates later than 0.5 s [%]"), strict=True):
        one.set_ylabel(text)
        one.set_ylim(0, 1.1 * one.get_ylim()[1])
        one.grid(alpha=0.3)
    axes[0].legend()
    axes[2].set_xlabel("time [s]")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, nargs="+", default=[10_000])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--image", type=Path, required=True)
    options = parser.parse_args()
    runs = [measure(axes, options.seconds) for axes in options.axes]
    write_figure(runs, options.image)
    options.out.write_text(HEAD + "\n".join(map(row, runs)) + "\n" + TAIL.format(image=options.image.name))
    print(options.out.read_text())


if __name__ == "__main__":
    main()
