"""Checks of a log, which report its mistakes before an estimate and with every estimate.

A check takes a `CheckedLog` and yields findings. Each group of checks has its own file. The checks say what the fit
cannot know: columns, units, clocks and counters. The fit names the effects that are unmodelled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from pmfid.config.axis import Axis
from pmfid.findings import Finding, codes, sort_findings
from pmfid.pipeline.checks.counter import find_frozen_counts, forgotten_bits, held_output
from pmfid.pipeline.checks.force import find_command, find_unsigned
from pmfid.pipeline.checks.inputs import find_saturation, held_input
from pmfid.pipeline.checks.readings import is_turned_by_gravity, no_motion, read_as
from pmfid.pipeline.checks.timing import odd_period, too_fast, too_slow
from pmfid.pipeline.checks.view import CheckedLog
from pmfid.records.gaps import bridge_input
from pmfid.records.joining import make_even, unbroken
from pmfid.records.record import Record

__all__ = ["FAMILIES", "Check", "check_record"]

Check = Callable[[CheckedLog], Iterator[Finding]]

#: Families of checks in their order. A mistake would confuse later families, and therefore ends the search.
FAMILIES: tuple[tuple[Check, ...], ...] = (
    (no_motion, forgotten_bits, too_fast),
    (find_unsigned, find_command),
    (read_as,),
    (held_output, find_frozen_counts, held_input, find_saturation),
    (too_slow, odd_period),
)


def check_record(record: Record, axis: Axis) -> tuple[Finding, ...]:
    """Return the findings of all checks."""
    record = make_even(record)
    log = CheckedLog(unbroken(replace(record, u=bridge_input(record.u))), axis)
    return sort_findings(_run_families(log))


def _run_families(log: CheckedLog) -> Iterator[Finding]:
    """Yield the findings of the families, up to the first family with more than a note.

    The families after that of the input read the motion as that of a body which gravity does not turn.
    """
    for family in FAMILIES:
        found = [finding for check in family for finding in check(log)]
        yield from found
        if codes(found) or (find_command in family and is_turned_by_gravity(log)):
            return
