"""Errors meant for people: one sentence that names what is wrong, the value and the remedy."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import ClassVar

__all__ = ["NotIdentifiableError", "PmfidError", "UsageError", "did_you_mean"]


class PmfidError(Exception):
    """Base of all errors that pmfid raises on purpose; its text is the whole message for the user."""

    #: Of the command that ends with it.
    exit_code: ClassVar[int] = 2


class UsageError(PmfidError):
    """Bad configuration, or input that cannot be read or used (exit code 2)."""


class NotIdentifiableError(PmfidError):
    """The data are in order, but cannot identify the parameters (exit code 3)."""

    exit_code: ClassVar[int] = 3


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Text `"; did you mean 'x'?"` with the choice closest to `word` (case ignored), or an empty text."""
    by_folded = {choice.casefold(): choice for choice in choices}
    closest = get_close_matches(word.casefold(), by_folded, n=1, cutoff=0.5)
    return f"; did you mean {by_folded[closest[0]]!r}?" if closest else ""
