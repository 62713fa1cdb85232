"""Public names of a package that are imported at their first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module

from pmfid.deprecation import warn_renamed


def make_getattr(
    package: str, public: Mapping[str, str], renamed: Mapping[str, str] | None = None
) -> Callable[[str], object]:
    """The `__getattr__` of a package. public: name -> module below the package that defines it; renamed: old name ->
    name."""
    new_names = renamed or {}

    def load(name: str) -> object:
        if name in new_names:
            warn_renamed(f"{package}.{name}", name := new_names[name])
        if name not in public:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{public[name]}"), name)

    return load
