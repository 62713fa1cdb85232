"""Explanations of all keys and status words, as text and on one page."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

import pmfid
from docs.keys import axis_page, plant_page
from pmfid.config.explain import entries
from pmfid.diagnostics.matter import FLAGS
from pmfid.status import Status
from tests.command import run_command

ROOT = Path(__file__).parents[1]
KEYS = {entry.name: entry for entry in entries() if "." in entry.name}


def said(*arguments: str) -> str:
    result = run_command("explain", *arguments)
    return result.output


def test_the_pages_of_all_keys_are_up_to_date() -> None:
    """If this fails, run: python -m docs.keys"""
    for name, page in (("axis_toml.md", axis_page()), ("plant_toml.md", plant_page())):
        assert (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8") == page


def codes_in(path: Path) -> set[str]:
    """Return the names that a module gives to findings, except for notes, which appear in no status."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        named = (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ("Finding", "_make_finding")
        )
        if not (named and isinstance(node.args[0], ast.Constant)):
            continue
        given = [*node.args, *(keyword.value for keyword in node.keywords)]
        if "note" not in [part.value for part in given if isinstance(part, ast.Constant)]:
            found.add(str(node.args[0].value))
    return found


def test_every_word_of_a_status_is_explained() -> None:
    known = {entry.name for entry in entries()}
    assert {str(bit.name).lower() for bit in Status} | set(FLAGS) <= known
    folder = Path(pmfid.__file__).parent
    found = {code for path in folder.rglob("*.py") for code in codes_in(path)}
    for node in ast.walk(ast.parse((folder / "diagnostics" / "processes.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Dict):
            found |= {str(key.value) for key in node.keys if isinstance(key, ast.Constant)}
    assert len(found) > 20
    assert found - known == set()


def test_the_command_says_it_in_the_terminal() -> None:
    text = said("record.time_unit")
    assert text.startswith("[record] time_unit: the unit of the time column")
    both = said("resolution", "model.offset")
    assert both.index("[encoder] resolution") < both.index("[model] offset")
    assert 'type: "s" or "ms"' in text
    assert "move the axis more, or use a longer memory" in said("poor_excitation")
    assert said("encoder").count("\n") == len([name for name in KEYS if name.startswith("encoder.")])
    assert sum(not line.startswith(" ") for line in said().splitlines()) == len(entries())
    assert max(map(len, said().splitlines())) <= 200
    (entry,) = json.loads(said("estimator.cutoff", "--json"))["entries"]
    assert (entry["name"], entry["unit"]) == ("estimator.cutoff", "rad/s")


@pytest.mark.parametrize(
    ("word", "wanted"),
    [
        ("service.window", "[service] window: the time for which"),
        ("[sources.hall] qos", "[sources.mqtt] qos: the quality of service: 1, or 0"),
        ("sources.hall.qos", "[sources.mqtt] qos: the quality of service: 1, or 0"),
        ("axes.x1.config", "[axes] config: the AXIS.toml"),
        ("sinks.phone.url", "[sinks.webhook] url"),
    ],
)
def test_keys_of_a_plant_are_explained_under_the_names_that_stand_there(word: str, wanted: str) -> None:
    assert wanted in said(word)
