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
    from pmfid.report.design import criteria_table, price_words, proof, recommendation, shows_encoder, std_table

    unknown = ", ".join(name.replace("_", " ") for name in appraisal.design.problem.unknown)
    _table(f"Input for {unknown}", criteria_table(appraisal))
    counted = shows_encoder(appraisal)
    title = "Predicted standard deviation after one run" + (", estimated from the counts" if counted else "")
    _table(title, std_table(appraisal, through_encoder=counted))
    _lines(proof(appraisal.design), recommendation(appraisal))
    _lines(*(f"warning: {text}" for text in appraisal.warnings))
    if appraisal.price is not None:
        _lines(price_words(appraisal.price))
    if out is not None:
        _lines(f"report: {out / 'report.html'}", f"motion: {out / 'design.csv'}")


def print_commissioning(state: Commissioning, out: Path | None) -> None:
    """Print the estimates after each round, and the next step."""
    from pmfid.report.design import rounds_table

    if state.rounds:
        _table("After each round: value ± standard deviation", rounds_table(state))
    if state.wanted and state.rounds:
        _lines("every wanted deviation is reached" if state.reached else "a wanted deviation is not yet reached")
    _lines(*(f"doubt: {text}" for text in state.doubts))
    if state.choice is None:
        return
    expected = ", ".join(
        f"{name.replace('_', ' ')} {f'{std:.3g}' if math.isfinite(std) else 'not known'}"
        for name, std in state.choice.std.items()
    )
    _lines(f"next input ({state.choice.name}): standard deviations expected of one run: {expected}")
    if out is not None:
        _lines(f"report: {out / 'report.html'}", f"motion: {out / 'design.csv'}")


def _table(title: str, content: tuple[list[str], list[list[str]]]) -> None:
    from rich.console import Console
    from rich.table import Table

    header, rows = content
    table = Table(title=title)
    for number, heading in enumerate(header):
        table.add_column(heading, justify="right" if number else "left", no_wrap=number == 0)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _lines(*texts: str) -> None:
    from rich.console import Console

    for text in texts:
        Console().print(text, highlight=False, markup=False, soft_wrap=True)
