"""Tables of calls that must be refused, with a pattern of the sentence that each error has for the user."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pmfid.errors import UsageError


def refused(*cases: tuple[str, Callable[[], object]], kind: type[Exception] = UsageError) -> None:
    """Check that the call of each case raises an error of a kind, whose text contains the pattern of the case."""
    for pattern, call in cases:
        with pytest.raises(kind, match=pattern):
            call()
