"""Study: does `pmfid check` name the faults of logs, and none in clean ones?

`python -m studies.checks --out docs/checks.md`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from pmfid.errors import UsageError
from pmfid.paper.truth import Study, Task, table
from pmfid.session.identify import check
from studies.check_logs import ALL, FAULTS, clean, faulty
from studies.friction_axes import BENCHES
from studies.sections import Page, by_name

#: Logs of each fault, and clean ones for each of these.
SEEDS, CLEAN = 20, 5
#: Other seeds than those on which the limits were chosen.
FIRST_SEED = 1000
NOTHING = "nothing"


def tasks(seeds: int) -> list[Task]:
    faults = list(product(FAULTS, range(FIRST_SEED, FIRST_SEED + seeds)))
    return [*faults, *((NOTHING, seed) for seed in range(FIRST_SEED, FIRST_SEED + CLEAN * seeds))]


def work(fault: str, seed: int) -> dict[str, Any]:
    """What is named in a log with a fault, and of which machine it is."""
    log = clean(seed) if fault == NOTHING else faulty(fault, seed)
    return {"found": named(log), "log": log.run.label}


def named(log: Any) -> list[str]:
    """Codes of the findings."""
    try:
        return [finding.code for finding in check(log.record(), log.configuration)]
    except UsageError:
        return ["unreadable"]


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    header = ["fault", "named", "something else", "nothing", "named in clean logs"]
    clean_logs = [found for (fault, _), found in results.items() if fault == NOTHING]
    rows = []
    for fault, (_, codes) in FAULTS.items():
        logs = [found["found"] for (name, _), found in results.items() if name == fault]
        hit = sum(bool(codes & set(found)) for found in logs)
        none = sum(not found for found in logs)
        false = sum(bool(codes & set(found["found"])) for found in clean_logs)
        rows.append(
            [fault, f"{hit} of {len(logs)}", str(len(logs) - hit - none), str(none), f"{false} of {len(clean_logs)}"]
        )
    named_clean = sum(bool(found["found"]) for found in clean_logs)
    missed = [
        [fault, str(seed), found["log"], ", ".join(found["found"]) or "nothing"]
        for (fault, seed), found in results.items()
        if (found["found"] if fault == NOTHING else not FAULTS[fault][1] & set(found["found"]))
    ]
    return [
        f"{seeds} logs of each fault, {len(clean_logs)} clean ones, of {len(ALL)} machines "
        f"({', '.join(sorted(BENCHES))} were held back when the limits were chosen; all seeds are new).",
        "",
        *table(header, rows),
        "",
        f"Something is named in {named_clean} of {len(clean_logs)} clean logs.",
        "",
        "## Every log that was read otherwise than it is",
        "",
        *(table(["fault", "seed", "log", "named"], missed) if missed else ["None."]),
    ]


INTRODUCTION = """\
Each log is a run of a machine between 1e-5 kg m2 and 500 kg, sampled every 0.1 to 20 ms: a random binary input, moves
with rests, five sines or slow ramps under position control; friction of viscous and Coulomb's kind, with Stribeck's,
quadratic, directional, uneven, cogging or a load beside it; the encoder of the machine, one 4 or one 16 times coarser.
A fault is put into such a log as `studies/check_logs.py` says. Faults that the encoder must show (a counter that ends
or sticks) are those of the encoder of the machine; drift is looked for under motions that have a time, not under slow
ramps; a limit of the input cuts off 5 to 20 % of the rows.
"""
PAGE = Page("checks", "Faults of logs", INTRODUCTION, by_name(Study("faults", tasks, work, write)), SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
