"""Sentences on a judgement: the doubt about a pair, and the refusal of a log that shows no axis."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from pmfid.findings import MOVE
from pmfid.io.tables import Table, column
from pmfid.pipeline.guess.pairs import MOTION, Judgement, Pair
from pmfid.pipeline.guess.roles import PAIRS_NOTHING, evidence_of
from pmfid.pipeline.stored import LONGEST_TEXT
from pmfid.types import Floats

#: Probability from which on a pair is written without a doubt, and smallest explained part.
PAIRS_SURE = 0.9
PAIRS_EXPLAINED = 0.3


def describe_doubt(pair: Pair, judgement: Judgement) -> str:
    """Return the doubt about a pair in numbers, with the next pair, or an empty text."""
    doubts = []
    if pair.against:
        doubts.append(pair.against)
    if pair.explained < PAIRS_EXPLAINED:
        doubts.append(f"the motion explains {100 * pair.explained:.3g} % of the input")
    if judgement.likely < PAIRS_SURE:
        doubts.append(f"the pair has a probability of {100 * judgement.likely:.0f} %")
    rival = judgement.rival
    if doubts and rival is not None and rival.score > PAIRS_NOTHING:
        doubts.append(f"next: {_describe(rival)}, with {_options(rival)}")
    return "; ".join(doubts)


def explain_refusal(judgement: Judgement, columns: Mapping[str, Floats], table: Table) -> str:
    """Return the refusal of a log that shows no input and output, with the numbers and the next best guess.

    Raises UsageError if a column that has the name of a motion has no numbers.
    """
    still = [name for name in table if name not in columns and evidence_of(name).lean(*MOTION) > 0]
    excluded = [f"{name} is {reason}" for name, reason in judgement.excluded.items()]
    forces = [name for name in columns if evidence_of(name).lean("input") > 0]
    seen = [name for name in columns if name not in judgement.excluded and evidence_of(name).lean(*MOTION) > 0]
    if still and not seen:
        column(table, "output", still[0])
        return f"the column {still[0]} is constant or grows evenly; {MOVE}, or name another column with --output"
    goal = next((name for name, reason in judgement.excluded.items() if reason == "a set point"), None)
    best = next(iter(judgement.pairs), None)
    if seen and goal and (best is None or best.explained == 0 or not forces):
        return (
            f"no column holds the force that drives {seen[0]}; log force, torque, current or duty, or for a servo add "
            f"the column u = {goal} - {seen[0]}"
        )
    if best is None and judgement.excluded:
        return f"no column is a measured motion: {_shorten(excluded)}; log the encoder, or name it with --output"
    if best is None:
        listed = [name if name in columns else f"{name} (constant, a clock, or no numbers)" for name in table]
        return (
            f"no two columns can be input and output of an axis: {_shorten(listed)}; name the columns with --input, "
            "--output and --time"
        )
    reason = f" ({best.against})" if best.against else ""
    others = [_describe(pair) for pair in judgement.pairs[1:3]]
    return (
        f"no two columns behave as input and output of an axis: {'; '.join([_describe(best) + reason, *others])}; log "
        f"force and position, or name the columns, next best: {_options(best)}"
    )


def _describe(pair: Pair) -> str:
    return f"the motion of {pair.output} explains {100 * pair.explained:.3g} % of {pair.input}"


def _options(pair: Pair) -> str:
    return shlex.join(["--input", pair.input, "--output", pair.output])


def _shorten(parts: Sequence[str]) -> str:
    text = ", ".join(parts)
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT].rpartition(' ')[0]} ..."
