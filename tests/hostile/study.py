"""Write a page on random calls of the commands: `python -m tests.hostile.study --out results/hostile.md`."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from pmfid.io import SPOKEN
from tests.hostile.commands import COMMANDS
from tests.hostile.verdict import DONE, NOT_IDENTIFIABLE, USAGE, Verdict, judge

CASES = 2000
#: Calls in one process: a new process ends the side effects of the calls before it.
PART = 1000

PAGE = """# Hostile input

Written by `make study`. {cases} calls of `pmfid`, each with files and options drawn at random from valid and broken
parts (`tests/hostile/commands.py`): every command; six plants, drives, equations and transfer functions; short records
as {formats} files, packed, damaged, with another ending; pipes with what loggers do; AXIS.toml, its
[monitor], and SPEC.toml with keys left out, of the wrong type, zero, huge, not finite; columns missing, exchanged,
scaled, empty, as text, with NaN; rows left out, repeated, reversed; counters that wrap; options of no, another or 400
digits' value; places that are taken or not there; names with control characters. Every warning counts as an error, and
so do a file that is no longer what it was, {hangs:g} s of the processor, and 400 MB. A monitor is calibrated on
{run:g} s of simulated work.

| command | calls | an estimate, a design, a file: exit code 0 | wrong usage, unreadable input: 2 | \
cannot be identified, or met: 3 | a traceback, a warning, another exit code | a number that is not finite, \
output next to an error, a control character, memory |
|---|---|---|---|---|---|---|
{rows}

`make hostile` attacks at length (`tests/hostile/campaign.py`): 300 000 crafted states with valid checksums, loaded and
stepped under AddressSanitizer and UBSan as Python, a fleet and an export have them; 10 000 openings of the memory; 1000
hostile names and units through an export; 20 000 of the calls above; the files of tests on pipes, files and signals.
`make hostile PARTS="states openings"` takes some of it, `PARTS=--quick` a look at all.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="the page")
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    options = parser.parse_args()
    verdicts = []
    for seed, verdict in judged(range(options.first, options.first + options.cases)):
        verdicts.append(verdict)
        for fault in verdict.faults:
            print(f"case {seed}: {verdict.command}: {fault}", flush=True)
    print("\n".join(rows(verdicts)))
    if options.out is not None:
        options.out.write_text(page(verdicts), "utf-8")
    return int(any(verdict.faults for verdict in verdicts))


def judged(seeds: range) -> Iterator[tuple[int, Verdict]]:
    """Yield number and verdict of each call; a call that ends its process raises BrokenProcessPool."""
    for start in range(0, len(seeds), PART):
        part = seeds[start : start + PART]
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            yield from zip(part, pool.map(judge, part, chunksize=20), strict=True)


def page(verdicts: list[Verdict]) -> str:
    """Return the page on the verdicts."""
    from tests.hostile.verdict import HANGS, RUN_TIME

    return PAGE.format(cases=len(verdicts), rows="\n".join(rows(verdicts)), hangs=HANGS, run=RUN_TIME, formats=SPOKEN)


def rows(verdicts: list[Verdict]) -> list[str]:
    """Return a table row for each command, and a row for all commands."""
    known = [name for name in COMMANDS if name != "none"]
    lines = [_row(f"`{name}`", [v for v in verdicts if v.command == name]) for name in known]
    lines.append(_row("none, or another word", [v for v in verdicts if v.command not in known]))
    return [*lines, _row("all", verdicts)]


def _row(name: str, verdicts: list[Verdict]) -> str:
    codes = Counter(verdict.code for verdict in verdicts)
    ends = [codes[DONE], codes[USAGE], codes[NOT_IDENTIFIABLE]]
    broken = len(verdicts) - sum(ends)
    faulty = sum(bool(v.faults) for v in verdicts if v.code in (DONE, USAGE, NOT_IDENTIFIABLE))
    return f"| {name} | {' | '.join(map(str, (len(verdicts), *ends, broken, faulty)))} |"


if __name__ == "__main__":
    raise SystemExit(main())
