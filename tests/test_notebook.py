"""The example notebook runs from its first cell to its last and shows the outputs that its text promises."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pytest
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART

PLACE = Path(__file__).parents[1] / "examples" / "notebook.ipynb"
NOTEBOOK = json.loads(PLACE.read_text(encoding="utf-8"))
CELLS = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def shown(cells: list[str]) -> Iterator[object]:
    """Yield the output of each cell: the value of its last line, as in a notebook."""
    names: dict[str, object] = {}
    for cell in cells:
        *before, last = ast.parse(cell).body
        exec(compile(ast.Module(before, []), "cell", "exec"), names)
        assert isinstance(last, ast.Expr), "a cell ends with what it shows"
        yield eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> list[object]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("notebook"))
        return list(shown(CELLS))


def test_it_is_a_notebook_without_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["cells"][0]["cell_type"]) == (4, "markdown")
    assert all(cell["outputs"] == [] for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code")
    text = json.dumps(NOTEBOOK, indent=1, ensure_ascii=False) + "\n"
    assert PLACE.read_text(encoding="utf-8") == text, "written as notebooks are, so that a change is a small one"


def test_it_goes_from_a_file_to_a_figure_in_six_lines(outputs: list[object]) -> None:
    lines = [line for line in CELLS[1].splitlines() if line]
    assert len(lines) == 6
    assert "read_csv" in lines[2]
    assert isinstance(outputs[1], Figure)


def test_what_it_shows_is_the_cart(outputs: list[object]) -> None:
    _, _, result, reported, frame, track = outputs
    assert isinstance(result, pmfid.Result)
    assert result.theta == pytest.approx([CART.mass, CART.viscous_friction, CART.coulomb_friction], rel=0.01)
    assert result["mass"] == reported["value"] == pytest.approx(CART.mass, rel=0.002)  # type: ignore[index]
    assert isinstance(frame, pl.DataFrame)
    assert frame["parameter"].to_list() == list(result.names)
    assert "<table>" in result._repr_html_()
    assert isinstance(track, Figure)


def test_a_notebook_without_pyplot_shows_the_figures(outputs: list[object]) -> None:
    for figure in (outputs[1], outputs[-1]):
        assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
