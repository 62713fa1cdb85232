"""Study whether `pmfid check` names the faults of logs, and none in clean logs.

`python -m studies.checks --out results/checks.md`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from pmfid.errors import UsageError
from pmfid.findings import codes
from pmfid.pipeline.identify import check
from studies.check_logs import ALL, FAULTS, clean, faulty, limited
from studies.friction_axes import BENCHES
from studies.paper.truth import Study, Task, table
from studies.sections import Page, by_name

#: Logs of each fault, and clean logs for each of these.
SEEDS, CLEAN = 20, 5
#: The limits were chosen on smaller seeds only.
FIRST_SEED = 20_000
NOTHING, LIMITED = "nothing", "nothing, drive at its limit"


def tasks(seeds: int) -> list[Task]:
    logs = [*FAULTS, LIMITED]
    seen = list(product(logs, range(FIRST_SEED, FIRST_SEED + seeds)))
    return [*seen, *((NOTHING, seed) for seed in range(FIRST_SEED, FIRST_SEED + CLEAN * seeds))]


def work(fault: str, seed: int) -> dict[str, Any]:
    """Return the findings in a log with a fault, and its machine."""
    log = clean(seed) if fault == NOTHING else limited(seed) if fault == LIMITED else faulty(fault, seed)
    return {**named(log), "log": log.run.label}


def named(log: Any) -> dict[str, list[str]]:
    """Return the codes of the findings that are faults, and the codes of the notes."""
    try:
        found = check(log.record(), log.configuration)
    except UsageError:
        return {"found": ["unreadable"], "notes": []}
    return {"found": list(codes(found)), "notes": [one.code for one in found if one.severity == "note"]}


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    header = ["fault", "named", "said in a note", "something else", "nothing", "named in clean logs"]
    clean_logs = [found for (fault, _), found in results.items() if fault == NOTHING]
    limited_logs = [found for (fault, _), found in results.items() if fault == LIMITED]
    rows = [[fault, *_counted(fault, results), _falsely(fault, clean_logs)] for fault in FAULTS]
    named_clean, named_limited = (sum(bool(one["found"]) for one in logs) for logs in (clean_logs, limited_logs))
    at_limit = sum(bool(one["notes"]) for one in clean_logs)
    missed = [
        [fault, str(seed), found["log"], ", ".join(found["found"]) or "nothing"]
        for (fault, seed), found in results.items()
        if (found["found"] if fault in (NOTHING, LIMITED) else not _hit(fault, found))
    ]
    return [
        f"{seeds} logs of each fault, {len(clean_logs)} clean ones, of {len(ALL)} machines "
        f"({', '.join(sorted(BENCHES))} were held back when the limits were first chosen; all seeds are new).",
        "",
        *table(header, rows),
        "",
        f"Something is named in {named_clean} of {len(clean_logs)} clean logs; {at_limit} of them have a note that "
        "their input is at its limit, which is so and costs nothing. Where the drive is at its limit for as much of "
        "the log as a log with a saturated input cuts off, something is named in "
        f"{named_limited} of {len(limited_logs)}.",
        "",
        "## Every log that was read otherwise than it is",
        "",
        *(table(["fault", "seed", "log", "named"], missed) if missed else ["None."]),
    ]


def _hit(fault: str, found: Mapping[str, Any]) -> bool:
    return bool(FAULTS[fault][1] & set(found["found"]))


def _counted(fault: str, results: Mapping[Task, Any]) -> list[str]:
    """Return the counts of a fault's logs: named, in a note, another fault named, and no finding."""
    logs = [found for (name, _), found in results.items() if name == fault]
    other = [found for found in logs if not _hit(fault, found)]
    in_note = [found for found in other if FAULTS[fault][1] & set(found["notes"])]
    else_ = [found for found in other if found not in in_note and found["found"]]
    left = len(other) - len(in_note) - len(else_)
    return [f"{len(logs) - len(other)} of {len(logs)}", str(len(in_note)), str(len(else_)), str(left)]


def _falsely(fault: str, clean_logs: Sequence[Mapping[str, Any]]) -> str:
    return f"{sum(_hit(fault, found) for found in clean_logs)} of {len(clean_logs)}"


INTRODUCTION = """\
Each log is a run of a machine between 1e-5 kg m2 and 500 kg, sampled every 0.1 to 20 ms: a random binary input, moves
with rests, five sines or slow ramps under position control; friction of viscous and Coulomb's kind, with Stribeck's,
quadratic, directional, uneven, cogging or a load next to it; the encoder of the machine, one 4 or one 16 times coarser.
A fault is put into such a log as `studies/check_logs.py` says. Faults that the encoder must show (a counter that ends
or sticks) are those of the encoder of the machine; a limit of the input cuts off 5 to 20 % of the rows, which is a note
before the fit. A note is no fault and ends with exit code 0.
"""
PAGE = Page("checks", "Faults of logs", INTRODUCTION, by_name(Study("faults", tasks, work, write)), SEEDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
