"""Designed inputs: their gain over a trapezoid, and the examples of the page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pmfid.design.solver import evaluate, solve
from pmfid.design.standard import standard_inputs
from studies.design_case import case

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "howto" / "design.md"


@pytest.mark.parametrize(
    ("unknown", "criterion", "least"), [("m", "trace", 1.2), ("m, d", "D", 2.0), ("m, d, F_c", "D", 4.5)]
)
def test_gain_over_the_trapezoid(unknown: str, criterion: str, least: float) -> None:
    problem = case(unknown)
    trapezoid = standard_inputs(problem, names=("trapezoid",))["trapezoid"].u
    design = solve(problem, criterion, starts=10)
    assert design.value >= least * evaluate(problem, trapezoid, criterion).value


def test_the_page_shows_the_example_as_it_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert (ROOT / "examples" / "cart_design.toml").read_text(encoding="utf-8").rstrip() in text


def test_the_page_example_in_python_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["mass"] == pytest.approx(1.8, rel=1e-3)
