"""Random configurations and records, as a page: `python -m tests.hostile.study --out docs/hostile.md`."""

from __future__ import annotations

import argparse
import multiprocessing
from collections import Counter
from pathlib import Path

from tests.hostile.verdict import DONE, NOT_IDENTIFIABLE, USAGE, Verdict, judge

CASES = 2000

PAGE = """# Hostile input

Written by `make study`. {cases} calls of `pmfid identify`, `compare`, `order` and `export`, each with an AXIS.toml and
a record drawn at random from valid and broken parts (`tests/hostile/draw.py`): five plants, drives, equations and
transfer functions; CSV, Parquet and MATLAB files; keys left out, of the wrong type, zero, huge, not finite; columns
missing, exchanged, scaled, empty, as text, with NaN; rows left out, repeated, reversed; counters that wrap; damaged
bytes; names with control characters. Every warning counts as an error.

| ends with | calls |
|---|---|
| an estimate, exit code 0 | {done} |
| wrong usage or unreadable input, exit code 2 | {usage} |
| data that cannot identify the parameters, exit code 3 | {refused} |
| a traceback, a warning, another exit code | {broken} |
| a number that is not finite, output beside an error, a control character | {faulty} |

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
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.cases)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        verdicts = dict(zip(seeds, pool.imap(judge, seeds, chunksize=10), strict=True))
    for seed, verdict in verdicts.items():
        for fault in verdict.faults:
            print(f"case {seed}: {fault}")
    text = page(list(verdicts.values()))
    print(text.partition("\n| ends")[2])
    if options.out is not None:
        options.out.write_text(text, "utf-8")
    return int(any(verdict.faults for verdict in verdicts.values()))


def page(verdicts: list[Verdict]) -> str:
    """The page of so many cases."""
    codes = Counter(verdict.code for verdict in verdicts)
    known = codes[DONE] + codes[USAGE] + codes[NOT_IDENTIFIABLE]
    faulty = sum(bool(verdict.faults) for verdict in verdicts if verdict.code in (DONE, USAGE, NOT_IDENTIFIABLE))
    return PAGE.format(
        cases=len(verdicts),
        done=codes[DONE],
        usage=codes[USAGE],
        refused=codes[NOT_IDENTIFIABLE],
        broken=len(verdicts) - known,
        faulty=faulty,
    )


if __name__ == "__main__":
    raise SystemExit(main())
