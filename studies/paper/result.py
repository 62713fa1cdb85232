"""A part of the page on the paper: a statement of the paper, what this project finds, and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    CONFIRMED = "confirmed"
    LIMITED = "confirmed within limits"
    REFUTED = "not confirmed"


@dataclass(frozen=True)
class Finding:
    """A verdict and the sentences that give the reason; `lines` are tables and pictures of a figure's section."""

    verdict: Verdict
    text: str
    lines: tuple[str, ...] = ()


def judge(holds: bool, otherwise: Verdict = Verdict.REFUTED) -> Verdict:
    return Verdict.CONFIRMED if holds else otherwise


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table, and the empty line after it."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:], ""]
