"""Docstrings of the public names: sections as NumPy writes them, and examples that run."""

from __future__ import annotations

import doctest
import inspect
import itertools

import pytest

import pmfid

OPTIONS = doctest.NORMALIZE_WHITESPACE


@pytest.mark.parametrize("name", pmfid.__all__)
def test_a_public_name_has_an_example_that_runs(name: str) -> None:
    thing = getattr(pmfid, name)
    text = inspect.getdoc(thing) or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples, "no example"
    messages: list[str] = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=messages.append)
    assert not messages, "".join(messages)


@pytest.mark.parametrize("name", pmfid.__all__)
def test_sections_are_those_of_numpy(name: str) -> None:
    lines = (inspect.getdoc(getattr(pmfid, name)) or "").splitlines()
    titles = [title for title, rule in itertools.pairwise(lines) if rule and set(rule) == {"-"}]
    order = ["Parameters", "Attributes", "Returns", "Raises", "Notes", "References", "Examples"]
    assert titles == [title for title in order if title in titles]
    assert titles[-1:] == ["Examples"]
    assert all(rule == "-" * len(title) for title, rule in itertools.pairwise(lines) if title in order)
