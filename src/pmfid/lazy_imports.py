"""Import of a package's public names at their first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def make_getattr(package: str, public: Mapping[str, str]) -> Callable[[str], object]:
    """Return the `__getattr__` function of a package.

    `public` maps each name to the module, below the package, that defines the name.
    """

    def load(name: str) -> object:
        if name not in public:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{public[name]}"), name)

    return load
