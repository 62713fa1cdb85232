"""The examples of README and pages run and give the true parameters; pages, words and names are complete."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import pmfid
from docs.blocks import FENCE, ROOT, Outcome, run_blocks
from docs.stage import WORDS, describe_commands, list_words, program
from pmfid.config.axis import load_axis
from tests.refusals import refused


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


def test_the_comparison_with_mujoco_leaves_its_intervals():
    section = (ROOT / "docs" / "coming_from.md").read_text("utf-8").partition("## mujoco.sysid")[2]
    assert "Both give confidence intervals" in section
    assert "error bar" not in section


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


def test_the_readme_shows_what_its_commands_print(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from examples import demo

    command, python, table = blocks("text", "README.md")
    shell = (ROOT / "README.md").read_text(encoding="utf-8").partition("    pip install")[2].partition("```")[0]
    lines = "\n".join(line.strip() for line in shell.splitlines()[1:] if line)
    (outcome,) = run_blocks(f"```sh\n{lines}\n```\n", tmp_path)
    check_output(outcome.text, command)
    assert [outcome.text for outcome in run_page("README.md", tmp_path, {})] == [python]
    demo.main(["--out", str(tmp_path)])
    check_output(capsys.readouterr().out, table)


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


def test_a_block_that_fails_is_an_error(tmp_path: Path) -> None:
    command = "```sh\npmfid identify missing.csv --config none.toml\n```\n"
    refused(("exit code 2", lambda: list(run_blocks(command, tmp_path))), kind=RuntimeError)
    with pytest.raises(ZeroDivisionError):
        list(run_blocks("```python\n1 / 0\n```\n", tmp_path))


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
