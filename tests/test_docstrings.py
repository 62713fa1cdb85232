"""Docstrings of the public names: sections as NumPy writes them, and examples that run."""

from __future__ import annotations

import doctest
import inspect
import itertools
from importlib import import_module

import pytest

import pmfid

OPTIONS = doctest.NORMALIZE_WHITESPACE
#: Packages that users import from, besides pmfid itself.
PACKAGES = ("pmfid.design", "pmfid.monitor", "pmfid.simulation", "pmfid.testing")


def list_names(package: str) -> list[str]:
    """Return the public names of a package; constants have comments in place of docstrings."""
    module = import_module(package)
    found = {name: getattr(module, name) for name in module.__all__}
    return [f"{package}.{name}" for name, thing in found.items() if inspect.isclass(thing) or inspect.isroutine(thing)]


def load(name: str) -> object:
    package, own = name.rsplit(".", 1)
    return getattr(import_module(package), own)


NAMES = [f"pmfid.{name}" for name in pmfid.__all__] + [name for package in PACKAGES for name in list_names(package)]


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_has_an_example_that_runs(name: str) -> None:
    if name.startswith("pmfid.design."):
        pytest.importorskip("highspy")
    text = inspect.getdoc(load(name)) or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples, "no example"
    messages: list[str] = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=messages.append)
    assert not messages, "".join(messages)


@pytest.mark.parametrize("name", NAMES)
def test_sections_are_those_of_numpy(name: str) -> None:
    lines = (inspect.getdoc(load(name)) or "").splitlines()
    titles = [title for title, rule in itertools.pairwise(lines) if rule and set(rule) == {"-"}]
    order = ["Parameters", "Attributes", "Returns", "Raises", "Notes", "References", "Examples"]
    assert titles == [title for title in order if title in titles]
    assert titles[-1:] == ["Examples"]
    assert all(rule == "-" * len(title) for title, rule in itertools.pairwise(lines) if title in order)
