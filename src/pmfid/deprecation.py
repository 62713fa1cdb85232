"""Old public names: each one works for one more version and warns."""

from __future__ import annotations

import warnings
from typing import Any


def warn_renamed(old: str, new: str) -> None:
    """Warn of a renamed public name, at the line that calls the caller of this function."""
    warnings.warn(f"{old} is now {new}; the old name goes in the next version", DeprecationWarning, stacklevel=3)


def rename_method(old: str, new: str) -> Any:
    """Return a class attribute for the old name of a method. The attribute warns and returns the method `new`."""

    def get(instance: object) -> object:
        warn_renamed(old, new)
        return getattr(instance, new)

    return property(get)
