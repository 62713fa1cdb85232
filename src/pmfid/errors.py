"""Errors for users. Each message is one sentence with the cause, the value and the remedy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from numbers import Integral, Real
from typing import ClassVar

#: Exit code of a command that the user ends with Ctrl-C (128 + SIGINT).
INTERRUPTED = 130


class PmfidError(Exception):
    """Base class of all errors that pmfid raises on purpose. The text of the error is the whole message for the user.

    Examples
    --------
    >>> from pmfid import PmfidError, UsageError
    >>> issubclass(UsageError, PmfidError), PmfidError.exit_code
    (True, 2)
    """

    #: Exit code of a command that ends with this error.
    exit_code: ClassVar[int] = 2


class UsageError(PmfidError):
    """Error for an invalid configuration, or for input that cannot be read or used (exit code 2).

    Examples
    --------
    >>> from pmfid import Encoder, UsageError
    >>> try:
    ...     Encoder(0.0)
    ... except UsageError as error:
    ...     print(error)
    resolution must be positive and finite, got 0.0: unit of position per count, as on the data sheet
    """


class NotIdentifiableError(PmfidError):
    """Error for valid data that cannot identify the parameters (exit code 3).

    Examples
    --------
    >>> from pmfid import NotIdentifiableError
    >>> NotIdentifiableError.exit_code
    3
    """

    exit_code: ClassVar[int] = 3


class UnknownParameterError(UsageError, KeyError):
    """Error for a parameter name that a result does not contain. The error is a KeyError too, as for any mapping."""

    def __str__(self) -> str:
        return str(self.args[0])  # the string method of KeyError would quote the sentence


def printable(text: str) -> str:
    """Return `text` with escapes in place of control characters except line feeds. A name must not control the
    terminal.
    """
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


def place_of(name: str, names: Sequence[str]) -> int:
    """Return the index of the parameter `name` in `names`. Raises UnknownParameterError with a list of all names if
    `name` is unknown.
    """
    if name not in names:
        listed = ", ".join(names)
        raise UnknownParameterError(f"there is no parameter {name!r}; use one of {listed}{did_you_mean(name, names)}")
    return list(names).index(name)


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return the text `"; did you mean 'x'?"` with the choice closest to `word`. The comparison ignores case. The
    text is empty if no choice is close.
    """
    by_folded = {choice.casefold(): choice for choice in choices}
    closest = get_close_matches(word.casefold(), by_folded, n=1, cutoff=0.5)
    return f"; did you mean {by_folded[closest[0]]!r}?" if closest else ""


def list_some(names: Iterable[str], most: int = 100) -> str:
    """Return names with commas, of which only the first fit into `most` characters, and the number of the others."""
    shown, others = list[str](), list(names)
    while others and len(", ".join([*shown, others[0]])) <= most:
        shown.append(others.pop(0))
    return ", ".join(shown) + (f" and {len(others)} more" if others else "")


def check_choice(name: str, value: object, choices: Iterable[str]) -> None:
    """Raise UsageError with the closest choice if `value`, which the user gave as `name`, is none of the choices."""
    known = tuple(choices)
    if value not in known:
        listed = ", ".join(map(repr, known))
        raise UsageError(f"{name} must be one of {listed}, got {value!r}{did_you_mean(str(value), known)}")


def whole_number(name: str, value: object, low: int | None, remedy: str) -> int:
    """Return `value` as an int; a float without a fraction, such as 2.0, is accepted.

    Raises UsageError for any other value, and for a value below `low`.
    """
    number: int | None = None
    try:
        if isinstance(value, Real) and not isinstance(value, bool):
            number = int(float(value)) if float(value).is_integer() else None
        if isinstance(value, Integral) and not isinstance(value, bool):
            number = int(value)
    except OverflowError:
        pass
    if number is None or (low is not None and number < low):
        least = "" if low is None else f" of at least {low}"
        raise UsageError(f"{name} must be a whole number{least}, got {value!r}; {remedy}")
    return number
