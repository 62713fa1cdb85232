"""Study the service during faults of other parts, each really caused: `pmfid serve`, Mosquitto and machines.

The processes share one computer. Faults of disks need root.

    python -m studies.service.faults --out results/service_faults.md
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from studies.service.disk_faults import disk_fault, forced_read_only, full
from studies.service.finding import Finding
from studies.service.hall import hall
from studies.service.message_faults import message_faults, wraps
from studies.service.page_faults import many_browsers, stopped, stuck_browser

HEAD = """# A service when something else fails

Each fault was played for real: `pmfid serve` with simulated carts at 100 samples a second through Mosquitto, on one
computer. *The page says* are the notices of `/api/news` since the fault, in the words of the log, without what the
motion itself does to the watch (watching, standstill); */metrics* are the totals that grew and the levels that changed,
without `pmfid_`. The verdict is computed: what must hold, and whether it does. "To the last bit" compares all rows that
the page has with what `pmfid monitor` says of the samples that were sent. Made by `make service-faults`.

| fault | the page says | /metrics | verdict |
| --- | --- | --- | --- |
"""

Part = Callable[[Path], Iterator[Finding]]


def in_one_hall(place: Path) -> Iterator[Finding]:
    """Yield the findings of successive faults on one service, which must survive them."""
    with hall(place, 12, 360.0) as there:
        yield from message_faults(there)
        yield stuck_browser(there)
        yield many_browsers(there)


def of_encoders(place: Path) -> Iterator[Finding]:
    yield wraps(place)


def of_disks(place: Path) -> Iterator[Finding]:
    yield disk_fault(place / "full", full)
    forced = forced_read_only(place / "forced")
    if forced is not None:
        yield forced


def of_the_process(place: Path) -> Iterator[Finding]:
    yield stopped(place / "held", "SIGSTOP for a minute; the broker holds all", losing=False)
    yield stopped(place / "lost", "SIGSTOP for a minute; the broker holds 550 messages, not the 1440", losing=True)


PARTS: dict[str, Part] = {
    "messages": in_one_hall,
    "encoders": of_encoders,
    "disks": of_disks,
    "process": of_the_process,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", choices=PARTS, nargs="+", default=list(PARTS))
    options = parser.parse_args()
    found: list[Finding] = []
    with tempfile.TemporaryDirectory() as name:
        for part in options.only:
            for finding in PARTS[part](Path(name) / part):
                found.append(finding)
                print(finding.row(), flush=True)
    as_they_should = sum(finding.holds for finding in found)
    tail = f"\n{as_they_should} of {len(found)} faults as they should be.\n"
    options.out.write_text(HEAD + "".join(f"{finding.row()}\n" for finding in found) + tail)
    print(tail)


if __name__ == "__main__":
    main()
