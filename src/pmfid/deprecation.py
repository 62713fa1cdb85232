"""Old public names, which work for one version and warn."""

from __future__ import annotations

import warnings
from typing import Any


def warn_renamed(old: str, new: str) -> None:
    """Warns at the line that calls the caller."""
    warnings.warn(f"{old} is now {new}; the old name goes in the next version", DeprecationWarning, stacklevel=3)


def rename_method(old: str, new: str) -> Any:
    """An attribute of a class, named `old`, that warns and is the method `new`."""

    def get(instance: object) -> object:
        warn_renamed(old, new)
        return getattr(instance, new)

    return property(get)
