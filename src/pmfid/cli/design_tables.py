"""Tables of a design and of a commissioning for the terminal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pmfid.design.appraisal import Appraisal
    from pmfid.design.rounds import Commissioning


def print_appraisal(appraisal: Appraisal, out: Path | None) -> None:
    """Print a design in comparison with the standard inputs, its predicted standard deviations, and its warnings."""
    from pmfid.cli.tables import print_table
    from pmfid.report.design import criteria_table, price_words, proof, recommendation, shows_encoder, std_table

    unknown = ", ".join(name.replace("_", " ") for name in appraisal.design.problem.unknown)
    print_table(f"Input for {unknown}", *criteria_table(appraisal))
    counted = shows_encoder(appraisal)
    title = "Predicted standard deviation after one run" + (", estimated from the counts" if counted else "")
    print_table(title, *std_table(appraisal, through_encoder=counted))
    lines = [proof(appraisal.design), recommendation(appraisal), *(f"warning: {text}" for text in appraisal.warnings)]
    lines += [price_words(appraisal.price)] if appraisal.price is not None else []
    _finish(lines, out)


def print_commissioning(state: Commissioning, out: Path | None) -> None:
    """Print the estimates after each round, and the next step."""
    from pmfid.cli.tables import print_table
    from pmfid.report.design import rounds_table

    if state.rounds:
        print_table("After each round: value ± standard deviation", *rounds_table(state))
    lines = []
    if state.wanted and state.rounds:
        lines.append("every wanted deviation is reached" if state.reached else "a wanted deviation is not yet reached")
    lines += [f"doubt: {text}" for text in state.doubts]
    if state.choice is None:
        _finish(lines, None)
        return
    expected = ", ".join(
        f"{name.replace('_', ' ')} {f'{std:.3g}' if math.isfinite(std) else 'not known'}"
        for name, std in state.choice.std.items()
    )
    lines.append(f"next input ({state.choice.name}): standard deviations expected of one run: {expected}")
    _finish(lines, out)


def _finish(lines: list[str], out: Path | None) -> None:
    from pmfid.cli.tables import print_lines

    motion = [f"motion: {out / 'design.csv'}"] if out is not None else []
    print_lines([*lines, *motion], out, "report.html")
