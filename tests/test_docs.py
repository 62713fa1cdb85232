"""What the README shows runs, and gives the truth."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import pmfid
from pmfid.session.config import load_axis

ROOT = Path(__file__).parents[1]


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)


def test_python_examples_find_the_cart():
    names: dict[str, object] = {}
    for code in blocks("python"):
        exec(code, names)
    fit = names["fit"]
    assert fit.theta == pytest.approx([1.07, 12.8, 0.8, 0.8], rel=0.02)
    estimate = names["estimate"]
    assert estimate.theta == pytest.approx([1.07, 12.8, 0.8], rel=0.1)
    assert estimate.theta[0] == pytest.approx(1.07, rel=0.01)


def test_toml_example_is_the_file(tmp_path):
    text = blocks("toml")[0]
    (tmp_path / "axis.toml").write_text(text)
    shown, file = load_axis(tmp_path / "axis.toml"), load_axis(ROOT / "examples" / "cart.toml")
    assert shown == file


def test_methods_named_are_the_methods_there_are():
    from pmfid.estimators.registry import ESTIMATORS

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| `([\w-]+)` \| `(\w+)` \|", readme, re.MULTILINE))
    assert table == {name: cls.__name__ for name, cls in ESTIMATORS.items()}


def test_version_is_one():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == pmfid.__version__


def test_pages_that_the_readme_names_exist():
    links = re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert links
    assert all((ROOT / link).exists() for link in links)
