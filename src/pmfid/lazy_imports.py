"""Import of a package's public names at their first use."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module

#: An import of a public name, which type checkers read and Python does not run.
_IMPORT = re.compile(r"^    from (\w+\.[\w.]+) import (\w+) as \2$", re.MULTILINE)


def read_names(file: str) -> dict[str, str]:
    """Return the public names of a package with the modules that define them.

    They are the names that the block `TYPE_CHECKING` in its `__init__.py`, given as `file`, imports.
    """
    with open(file, encoding="utf-8") as text:  # the import of pathlib takes longer
        return {name: module for module, name in _IMPORT.findall(text.read())}


def make_getattr(package: str, public: Mapping[str, str]) -> Callable[[str], object]:
    """Return the `__getattr__` function of a package. `public` maps each name to the module that defines it."""

    def load(name: str) -> object:
        if name not in public:
            from pmfid.errors import did_you_mean

            raise AttributeError(f"module {package!r} has no attribute {name!r}{did_you_mean(name, public)}")
        value = getattr(import_module(public[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load
