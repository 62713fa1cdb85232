"""Pages: examples run, the notebook and the demo too."""

from __future__ import annotations

import ast
import json
import re
import runpy
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

import pmfid
from docs.blocks import FENCE, ROOT, Outcome, run_blocks
from docs.stage import WORDS, describe_commands, list_words, program
from examples.demo import INCREMENTS, METHODS, RECORD, estimate_mass, main, rms_error, simulate_run
from pmfid.config.axis import load_axis
from pmfid.simulation import CART, CART_LOADED
from tests.command import run_command


def blocks(language: str, page: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


def run_page(page: str, folder: Path, names: dict[str, Any]) -> list[Outcome]:
    return list(run_blocks((ROOT / page).read_text(encoding="utf-8"), folder, names))


@pytest.mark.parametrize(
    ("page", "name", "theta"),
    [
        ("README.md", "result", [1.07, 12.8, 0.8]),
        ("docs/howto/python.md", "estimate", [1.07, 12.8, 0.8]),
        ("docs/explanation/models.md", "fit", [1.07, 12.8, 0.8, 0.8]),
    ],
)
def test_python_examples_find_the_cart(page: str, name: str, theta: list[float], tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    run_page(page, tmp_path, names)
    assert names[name].theta == pytest.approx(theta, rel=0.1)
    assert names[name].theta[0] == pytest.approx(1.07, rel=0.01)


def test_toml_example_is_the_file_and_the_version_is_one(tmp_path):
    text = blocks("toml", "docs/howto/records.md")[0]
    (tmp_path / "axis.toml").write_text(text)
    shown, file = load_axis(tmp_path / "axis.toml"), load_axis(ROOT / "examples" / "cart.toml")
    assert shown == file
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"] == pmfid.__version__


def test_methods_named_are_the_methods_there_are():
    from pmfid.estimators.registry import ESTIMATORS

    guide = (ROOT / "docs/explanation/models.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| `([\w-]+)` \| `(\w+)` \|", guide, re.MULTILINE))
    assert table == {name: cls.__name__ for name, cls in ESTIMATORS.items()}


def numbers_apart(text: str) -> tuple[str, list[float]]:
    """Return a text without its numbers, and the numbers."""
    number = r"[-+]?\d+(?:\.\d+)?(?:e-?\d+)?"
    return " ".join(re.sub(number, "#", text).split()), [float(found) for found in re.findall(number, text)]


def check_output(printed: str, shown: str) -> None:
    """Require the shown text in an output, with numbers that agree to 1 % or to the last digit shown."""
    (text, values), (wanted, expected) = numbers_apart(printed), numbers_apart(shown)
    assert wanted in text
    first = text[: text.index(wanted)].count("#")
    assert values[first : first + len(expected)] == pytest.approx(expected, rel=0.01, abs=0.02)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder that the demo wrote, and its printed text."""
    place, text = tmp_path_factory.mktemp("demo"), StringIO()
    with redirect_stdout(text):
        main(["--out", str(place), "--images", str(place / "images")])
    return place, text.getvalue()


def test_the_readme_shows_what_its_commands_print(tmp_path: Path, demo: tuple[Path, str]) -> None:
    command, python, table = blocks("text", "README.md")
    shell = (ROOT / "README.md").read_text(encoding="utf-8").partition("    pip install")[2].partition("```")[0]
    lines = "\n".join(line.strip() for line in shell.splitlines()[1:] if line)
    (outcome,) = run_blocks(f"```sh\n{lines}\n```\n", tmp_path)
    check_output(outcome.text, command)
    assert [outcome.text for outcome in run_page("README.md", tmp_path, {})] == [python]
    check_output(demo[1], table)


def test_the_skill_works_when_followed_literally(tmp_path: Path) -> None:
    outcomes = run_page("SKILL.md", tmp_path, {})
    assert "# TO DO" not in (tmp_path / "AXIS.toml").read_text(encoding="utf-8")
    assert "mass 1.0701 kg status: none" in outcomes[-1].text
    assert '"findings": []' in outcomes[2].text


def test_the_skill_has_a_row_for_each_status_word() -> None:
    text = (ROOT / "SKILL.md").read_text(encoding="utf-8").partition("## What to do for each status word")[2]
    rows = re.findall(r"^\| (`.*?`) \|", text, re.MULTILINE)
    assert sorted(word for row in rows for word in re.findall(r"\w+", row)) == sorted(list_words())


PAGES = [
    "README.md",
    "SKILL.md",
    "llms.txt",
    "ARCHITECTURE.md",
    *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))),
]
#: Pages that the build of the site writes.
BUILT = {"commands.md", "gallery/index.rst"}
#: Pages of status words. `make docs` runs the blocks of all of them, and the fast tests those of one.
STATUS = [page for page in PAGES if page.startswith("docs/howto/status/")]


#: Pages on one kind of axis whose blocks run.
AXES = ["docs/howto/lerobot.md", "docs/howto/frc.md", "docs/howto/elastic.md", "docs/howto/real_axes.md"]


@pytest.mark.parametrize(
    "page",
    [
        "docs/coming_from.md",
        "docs/paper.md",
        STATUS[0],
        *(pytest.param(page, marks=pytest.mark.long) for page in (*STATUS[1:], *AXES)),
    ],
)
def test_blocks_of_a_page_run_and_show_something(page: str, tmp_path: Path) -> None:
    outcomes = run_page(page, tmp_path, {"__name__": "page"})
    assert outcomes
    assert all(outcome.text or outcome.figures for outcome in outcomes)


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith("docs/start/")])
def test_a_tutorial_runs_as_it_is_printed(page: str, tmp_path: Path) -> None:
    fences = FENCE.findall((ROOT / page).read_text(encoding="utf-8"))
    assert len(run_page(page, tmp_path, {"__name__": "page"})) == len(fences)


@pytest.mark.long
@pytest.mark.parametrize("script", sorted((ROOT / "examples/gallery").glob("*.py")), ids=lambda path: path.stem)
def test_an_example_of_the_gallery_prints_and_draws(script: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = runpy.run_path(str(script))
    assert capsys.readouterr().out
    assert any(isinstance(value, Figure) for value in names.values())


@pytest.mark.parametrize("page", PAGES)
def test_pages_that_a_page_names_exist(page: str) -> None:
    text = re.sub(r"^```.*?^```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    links = re.findall(r"\]\((?!http)([^)#]+)\)", text)
    assert links or page != "README.md"
    assert [link for link in links if link not in BUILT and not ((ROOT / page).parent / link).exists()] == []


def test_the_page_of_status_words_has_each_word_once() -> None:
    page = (ROOT / "docs/howto/status.md").read_text(encoding="utf-8")
    assert sorted(" ".join(WORDS.findall(page)).split()) == sorted(list_words())
    pages = {path.stem for path in (ROOT / "docs/howto/status").glob("*.md")}
    assert pages == set(re.findall(r"^status/(\w+)$", page, re.MULTILINE))
    assert pages <= set(list_words())


def test_the_reference_has_each_public_name_and_each_command() -> None:
    page = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^   (\w+)$", page, re.MULTILINE)) == sorted(pmfid.__all__)
    commands = "".join(describe_commands(program, "pmfid"))
    assert {"## pmfid identify", "## pmfid fleet history"} <= set(commands.splitlines())
    assert "| `--set KEY=VALUE` |" in commands


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


@pytest.fixture(scope="module")
def errors() -> dict[tuple[str, int], float]:
    runs = {n: simulate_run(n) for n in (4096, 256, 64)}
    return {(method, n): rms_error(estimate_mass(method, run)["mass"]) for n, run in runs.items() for method in METHODS}


def test_rls_goes_off_and_bcrls_does_not(errors: dict[tuple[str, int], float]) -> None:
    assert errors["RLS", 4096] < 1
    assert errors["RLS", 256] > 25
    assert errors["BCRLS", 256] < 1


def test_riv_and_edge_times_go_beyond(errors: dict[tuple[str, int], float]) -> None:
    assert errors["riv", 64] < errors["BCRLS", 64] / 1.5
    assert errors["edge times", 64] < 0.05


def test_the_error_is_that_of_both_loads() -> None:
    mass = np.r_[np.full(1500, 1.1 * CART.mass), np.full(1500, CART_LOADED.mass)]
    assert rms_error(mass) == pytest.approx(10 / np.sqrt(2))


def test_the_command_prints_one_table_and_writes_its_files(demo: tuple[Path, str]) -> None:
    place, text = demo
    assert max(map(len, text.partition("\npicture:")[0].splitlines())) <= 80
    assert [line.split()[0] for line in text.splitlines()[2 : 2 + len(INCREMENTS)]] == [str(n) for n in INCREMENTS]
    assert (place / "images" / "first.png").stat().st_size > 10_000
    assert (place / "images" / "demo.png").read_bytes() == (place / "demo.png").read_bytes()
    t, u, counts = np.loadtxt(place / "cart.csv", delimiter=",", skiprows=1, unpack=True)
    estimator = pmfid.BCRLS(
        pmfid.Drive(2.0), pmfid.Encoder(22.75e-6 * 4096 / RECORD), t[1] - t[0], 50.0, forgetting=0.99
    )
    assert estimator.run(u, counts.astype(int))["mass"][-1] == pytest.approx(1.44, rel=0.02)
    command = text.partition("next: ")[2].split()[:-2]
    assert command[:2] == ["pmfid", "identify"]
    assert "mass" in run_command(*command[1:]).output
