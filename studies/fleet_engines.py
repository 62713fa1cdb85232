"""The history of a fleet by both engines, from the same files: the same bytes, and what each costs:
`python -m studies.fleet_engines --out results/fleet_engines.md`; needs `pmfid[spark]` and a Java runtime."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from os import getpid, sysconf
from pathlib import Path

from pmfid import fleet
from studies.fleet_data import write_fleet
from studies.paper.truth import table

TABLES = ("periods", "axes", "problems")
#: Tasks at once, of both.
WORKERS = 2
#: Between looks at the processes [s].
LOOK = 0.25


@dataclass
class Watched:
    """Of this process and all below it, the virtual machine of Java and the Python of the executors among them: the
    largest sum of their proportional memories [MiB], and processor time [s] as last seen of each."""

    memory: float = 0.0
    java: float = 0.0
    cpu: dict[int, float] = field(default_factory=dict)

    def look(self) -> None:
        sizes = {process: _memory(process) for process in _family(getpid())}
        self.memory = max(self.memory, sum(sizes.values()))
        self.java = max(self.java, max((sizes[one] for one in sizes if _name(one) == "java"), default=0.0))
        self.cpu |= {process: _cpu(process) for process in sizes}


def _family(process: int) -> Iterator[int]:
    yield process
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            below = path.read_text().split()
        except OSError:
            continue
        for child in below:
            yield from _family(int(child))


def _memory(process: int) -> float:
    """Pages that several share count in parts [MiB]; 0 of one that has ended."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _cpu(process: int) -> float:
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / sysconf("SC_CLK_TCK")


def _name(process: int) -> str:
    try:
        return Path(f"/proc/{process}/comm").read_text().strip()
    except OSError:
        return ""


@contextmanager
def watching() -> Iterator[Watched]:
    """Looks at the processes until it is left."""
    found, done = Watched(), threading.Event()

    def watch() -> None:
        while not done.wait(LOOK):
            found.look()

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield found
    finally:
        done.set()
        thread.join()
        found.look()


def measure(folder: Path, name: str) -> dict[str, object]:
    """One engine, from nothing to tables, in this process. The start of Spark is reported separately."""
    start = time.perf_counter()
    engine: fleet.Engine = fleet.Local(WORKERS) if name == "local" else fleet.Spark(f"local[{WORKERS}]")
    with tempfile.TemporaryDirectory() as out, watching() as watched:
        if isinstance(engine, fleet.Spark):
            session = engine.session()
            session.range(0, WORKERS, 1, WORKERS).mapInArrow(lambda batches: batches, "id long").toArrow()
        begin = time.perf_counter()
        found = fleet.estimate(
            folder / "data", axis=folder / "axis.toml", by="machine", period="10min", engine=engine, out=out
        )
        wall = time.perf_counter() - begin
        bytes_of = {one: sha256((Path(out) / f"{one}.parquet").read_bytes()).hexdigest() for one in TABLES}
    return {
        "engine": name,
        "samples": found.samples,
        "start": begin - start,
        "wall": wall,
        "cpu": sum(watched.cpu.values()),
        "memory": watched.memory,
        "java": watched.java,
        "named": sorted(found.named["axis"].to_list()),
        "bytes": bytes_of,
    }


def in_a_process(folder: Path, name: str) -> dict[str, object]:
    """The same in a process of its own."""
    command = [sys.executable, "-m", "studies.fleet_engines", "--measure", str(folder), "--engine", name]
    return dict(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout))


def page(axes: int, hours: float, changed: set[str], runs: list[dict[str, object]], load: str) -> str:
    """runs: of each engine; load: what else the machine did."""
    rows = []
    for run in runs:
        samples, start, wall, cpu, memory, java = (
            float(str(run[name])) for name in ("samples", "start", "wall", "cpu", "memory", "java")
        )
        rate, each = samples / wall / 1e6, samples / cpu / 1e6
        rows.append([str(run["engine"]), f"{samples / 1e6:.0f} M", f"{start:.1f}", f"{wall:.0f}", f"{cpu:.0f}",
                     f"{rate:.2f} M", f"{each:.2f} M", f"{memory:.0f}", f"{java:.0f}"])  # fmt: skip
    named = [set(map(str, run["named"])) for run in runs]  # type: ignore[call-overload]
    same = all(run["bytes"] == runs[0]["bytes"] for run in runs)
    header = ("engine", "samples", "start [s]", "wall [s]", "processor [s]", "samples/s", "per processor second",
              "MiB, all processes", "of these Java")  # fmt: skip
    lines = [
        "# The history of a fleet by both engines",
        "",
        f"Written by `python -m studies.fleet_engines --axes {axes} --hours {hours:g}`: {axes} simulated axes, "
        f"{hours:g} h at 100 Hz, {len(changed)} of which change (`python -m studies.fleet_data`), from Parquet to "
        f"tables, {WORKERS} tasks at once, each engine in a process of its own. {load}",
        "",
        f"The tables {', '.join(TABLES)} of both are {'the same' if same else '**not** the same'}, byte by byte. "
        f"{len(named[0] & changed)} of the {len(changed)} that changed are named, {len(named[0] - changed)} others.",
        "",
        *table(header, rows),
        "Start: of the process, and of Spark with its executors. Processor time has the start in it. Memory: the "
        "largest sum over driver, Java and executors at one time, shared pages in parts (`Pss`).",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--folder", type=Path, help="of a fleet that is there already")
    parser.add_argument("--load", default="", help="what else the machine did, for the page")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--engine", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure is not None:
        print(json.dumps(measure(arguments.measure, arguments.engine)))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = arguments.folder or Path(name)
        if arguments.folder is None:
            changed = max(1, round(0.03 * arguments.axes))
            write_fleet(folder, arguments.axes, changed, arguments.hours, seed=11, workers=WORKERS)
        truth = set(json.loads((folder / "truth.json").read_text(encoding="utf-8")))
        runs = [in_a_process(folder, engine) for engine in ("local", "spark")]
    arguments.out.write_text(page(arguments.axes, arguments.hours, truth, runs, arguments.load), encoding="utf-8")


if __name__ == "__main__":
    main()
