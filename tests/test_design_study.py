"""The study of designed inputs: the claims that a short run can check, and the page."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pmfid.design.solver import evaluate, solve
from pmfid.design.standard import standard_inputs
from pmfid.report.figures import save_png
from pmfid.simulation.scenarios import resolution_of
from studies import design_runs, design_wrong
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


def test_the_robust_design_breaks_no_limit_in_any_scenario() -> None:
    rows = list(design_wrong.robust())
    assert len(rows) == len(design_wrong.WRONG)
    assert {row[-1] for row in rows} == {"no"}


def test_breaking_a_limit_is_seen() -> None:
    problem = case("m")
    kept = design_wrong.Outcome(1.0, 0.4, 0.4, 0.01, 0.0)
    assert not design_wrong.breaks(problem, kept)
    for change in ({"end": 0.38}, {"highest": 0.41}, {"slowest": 0.0}, {"end_velocity": 0.02}):
        assert design_wrong.breaks(problem, design_wrong.Outcome(**{**vars(kept), **change}))


@pytest.mark.long
def test_after_two_rounds_the_design_is_that_of_the_true_mass() -> None:
    problem = case("m")
    best = float(design_wrong.optimum(problem).fisher[0, 0])
    for factor in (0.8, 1.2):
        start = design_wrong.for_mass(problem, factor * 1.5)
        designs, masses = design_wrong._history(problem, start, 0, 2)
        first, second = (design_wrong.outcome(problem, design.u, best) for design in designs)
        assert abs(second.end / 0.4 - 1) < 0.02
        assert 0.85 < second.information < 1.02, "by the counts a larger least speed is better than by white noise"
        assert abs(first.information - 1) > 0.02, "the first design was for the wrong mass"
        assert masses[-1] == pytest.approx(1.5, rel=1e-3)


def test_experiments_scatter_as_the_encoder_says() -> None:
    problem = case("m, d, F_c", resolution=resolution_of(1024))
    trapezoid = standard_inputs(problem, names=("trapezoid",))["trapezoid"].u
    found = design_runs.trial(problem, trapezoid, "least squares", 100)
    assert found.failures == 0
    assert found.std == pytest.approx(found.encoder, rel=0.25)
    noisy = design_runs.trial(problem, trapezoid, "white noise", 100)
    assert noisy.std == pytest.approx(noisy.unknown_start, rel=0.25)
    assert np.all(found.unknown_start >= found.predicted)


def test_figure_two_shows_both_designs(tmp_path: Path) -> None:
    figure = design_wrong.wrong_mass_figure()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["nominal mass", "mass wrong by +20 %"]
    end = [line.get_ydata()[-1] for line in figure.axes[2].get_lines()[:2]]
    assert end[0] == pytest.approx(0.4, abs=1e-9)
    assert end[1] > 0.41
    save_png(figure, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_the_page_shows_the_example_as_it_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert (ROOT / "examples" / "cart_design.toml").read_text(encoding="utf-8").rstrip() in text


def test_the_page_example_in_python_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["mass"] == pytest.approx(1.8, rel=1e-3)
