"""All attacks at length: `python -m tests.hostile.campaign`, or `make hostile`; `--quick` makes a short run.

Each part prints a line. The exit code is 1 if a part finds a fault.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.hostile.crafted import PLACES, attack, estimators, folder_of, program
from tests.hostile.names import faults_of_names, hostile_names
from tests.hostile.openings import faults_of
from tests.hostile.study import judged

#: Numbers of attacks in a full run and in a quick one: crafted states (over all estimators and places), openings,
#: names, calls.
FULL = {"states": 300_000, "openings": 10_000, "names": 1000, "calls": 20_000}
QUICK = {"states": 3000, "openings": 500, "names": 20, "calls": 50}
#: Test files that attack files, pipes, signals and many axes; these tests are fast and complete.
FILES = (
    "test_pipe_faults.py",
    "test_monitor_files.py",
    "test_monitor_run.py",
    "test_many.py",
    "test_export_names.py",
    "test_closed_streams.py",
    "test_unpacked.py",
)
Faults = Iterator[str]


def crafted_states(amount: int) -> Faults:
    """Load and step states with valid checksums under the sanitizers: in Python, in a fleet and in an export."""
    cases = list(estimators())
    each = -(-amount // (len(cases) * len(PLACES)))
    built: dict[tuple[str, ...], Path] = {}
    taken = 0
    with tempfile.TemporaryDirectory() as name:
        for number, (case, estimator) in enumerate(cases):
            for place in PLACES:
                key = (place, estimator.precision, case if place == "export" else "")
                if key not in built:
                    built[key] = program(estimator, place, Path(name) / "-".join(key))
                outcome = attack(built[key], folder_of(estimator, place, Path(name) / place / case), each, number)
                taken += outcome.taken
                if outcome.report:
                    yield f"{case} as {place}: {outcome.report}"
    print(f"  {taken} of {each * len(cases) * len(PLACES)} were taken and stepped", flush=True)


def openings(amount: int) -> Faults:
    cases = list(estimators())
    for number, (case, estimator) in enumerate(cases):
        for fault in faults_of(estimator, np.random.default_rng(number), -(-amount // len(cases))):
            yield f"{case}: {fault}"


def names(amount: int) -> Faults:
    yield from faults_of_names(hostile_names(amount))


def calls(amount: int) -> Faults:
    for seed, verdict in judged(range(amount)):
        for fault in verdict.faults:
            yield f"call {seed}, {verdict.command}: {fault}"


def files(_: int) -> Faults:
    here = Path(__file__).parents[1]
    if pytest.main(["-q", "-p", "no:benchmark", *(str(here / name) for name in FILES)]) != 0:
        yield "files, pipes and signals: see above"


PARTS: dict[str, Callable[[int], Faults]] = {
    "states": crafted_states,
    "openings": openings,
    "names": names,
    "calls": calls,
    "files": files,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="some of them (default: all)")
    parser.add_argument("--quick", action="store_true", help="a small number of each")
    options = parser.parse_args()
    found = 0
    for name in options.parts or PARTS:
        amount = (QUICK if options.quick else FULL).get(name, 0)
        print(f"{name}{f', {amount}' if amount else ''}", flush=True)
        start = time.monotonic()
        for fault in PARTS[name](amount):
            found += 1
            print(f"  {fault}", flush=True)
        print(f"  {time.monotonic() - start:.0f} s", flush=True)
    print(f"{found} faults")
    return int(found > 0)


if __name__ == "__main__":
    raise SystemExit(main())
