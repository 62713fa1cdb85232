"""The examples of the README run and give the true parameters."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

import pmfid
from pmfid.config.axis import load_axis

ROOT = Path(__file__).parents[1]


def blocks(language: str, page: str = "README.md") -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    ("page", "name", "theta"),
    [
        ("README.md", "result", [1.07, 12.8, 0.8]),
        ("docs/guide/python.md", "estimate", [1.07, 12.8, 0.8]),
        ("docs/guide/models.md", "fit", [1.07, 12.8, 0.8, 0.8]),
    ],
)
def test_python_examples_find_the_cart(page: str, name: str, theta: list[float]) -> None:
    names: dict[str, Any] = {}
    for code in blocks("python", page):
        exec(code, names)
    assert names[name].theta == pytest.approx(theta, rel=0.1)
    assert names[name].theta[0] == pytest.approx(1.07, rel=0.01)


def test_toml_example_is_the_file(tmp_path):
    text = blocks("toml")[0]
    (tmp_path / "axis.toml").write_text(text)
    shown, file = load_axis(tmp_path / "axis.toml"), load_axis(ROOT / "examples" / "cart.toml")
    assert shown == file


def test_methods_named_are_the_methods_there_are():
    from pmfid.estimators.registry import ESTIMATORS

    guide = (ROOT / "docs/guide/models.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| `([\w-]+)` \| `(\w+)` \|", guide, re.MULTILINE))
    assert table == {name: cls.__name__ for name, cls in ESTIMATORS.items()}


def test_version_is_one():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == pmfid.__version__


@pytest.mark.parametrize(
    "page", ["README.md", *(f"docs/guide/{path.name}" for path in (ROOT / "docs/guide").iterdir())]
)
def test_pages_that_a_page_names_exist(page: str) -> None:
    links = re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / page).read_text(encoding="utf-8"))
    assert links or page != "README.md"
    assert all(((ROOT / page).parent / link).exists() for link in links)
