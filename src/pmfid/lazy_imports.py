"""Import of a package's public names at their first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module

from pmfid.deprecation import warn_renamed


def make_getattr(
    package: str, public: Mapping[str, str], renamed: Mapping[str, str] | None = None
) -> Callable[[str], object]:
    """Return the `__getattr__` function of a package.

    `public` maps each name to the module, below the package, that defines the name. `renamed` maps old names to new
    ones.
    """
    new_names = renamed or {}

    def load(name: str) -> object:
        if name in new_names:
            warn_renamed(f"{package}.{name}", name := new_names[name])
        if name not in public:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{public[name]}"), name)

    return load
