"""Workflow files call targets that exist, wheels are asked for every Python, and the list of parts is true."""

from __future__ import annotations

import re
import shlex
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.wheel import check_contents

REPOSITORY = Path(__file__).parents[1]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_call_targets_that_exist(path: Path) -> None:
    yaml = pytest.importorskip("ruamel.yaml")
    jobs = yaml.YAML(typ="safe").load(path.read_text(encoding="utf-8"))["jobs"]
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    targets = [found[1] for command in commands if (found := re.match(r"make ([\w-]+)", command))]
    assert targets
    assert [target for target in targets if not re.search(rf"^{target}:", makefile, re.MULTILINE)] == []
    assert len(targets) >= len(commands) - 1  # the other one installs make on Windows


def test_the_scheduled_tests_take_the_code_of_other_processors() -> None:
    yaml = pytest.importorskip("ruamel.yaml")
    workflow = yaml.YAML(typ="safe").load((REPOSITORY / ".github/workflows/processors.yml").read_text(encoding="utf-8"))
    assert "schedule" in workflow["on"]
    settings = workflow["jobs"]["test"]["strategy"]["matrix"]["setting"]
    read = [dict(part.split("=", 1) for part in shlex.split(setting)) for setting in settings]
    features = [{"NPY_DISABLE_CPU_FEATURES": names} for names in ("X86_V4", "X86_V3 X86_V4")]
    assert read == [{}, *features, *({"OPENBLAS_CORETYPE": name} for name in ("Haswell", "SkylakeX", "Prescott"))]


def test_forms_and_the_citation_are_valid() -> None:
    yaml = pytest.importorskip("ruamel.yaml")
    read = {
        path.name: yaml.YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        for path in [
            *(REPOSITORY / ".github" / "ISSUE_TEMPLATE").glob("*.yml"),
            REPOSITORY / "CITATION.cff",
            REPOSITORY / ".pre-commit-config.yaml",
        ]
    }
    citation = read.pop("CITATION.cff")
    assert (citation["version"], citation["license"]) == (PROJECT["project"]["version"], PROJECT["project"]["license"])
    hooks = [hook["entry"] for repo in read.pop(".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]]
    assert any(hook.startswith(".venv/bin/ruff check") for hook in hooks)
    assert len(read) == 3
    for form in read.values():
        assert {"name", "description", "body"} <= set(form)
        assert all({"type", "id", "attributes"} <= set(part) for part in form["body"])


def test_wheels_are_asked_for_every_python_that_is_supported() -> None:
    asked = PROJECT["tool"]["cibuildwheel"]["build"]
    assert asked == ["cp311-*", "cp312-*", "cp313-*", "cp314-*", "cp314t-*"]
    assert PROJECT["project"]["requires-python"] == ">=3.11"


def read_locked(name: str) -> dict[str, str]:
    """Return each pin of a lock file with its hashes."""
    text = (REPOSITORY / name).read_text(encoding="utf-8").replace("\\\n", "")
    return {pin.strip(): hashes for pin, hashes in re.findall(r"^(\S+==[^\n]*?) (--hash[^\n]*)$", text, re.MULTILINE)}


@pytest.mark.parametrize("name", ["requirements-build.txt", "requirements-dev.txt", "requirements-docs.txt"])
def test_every_locked_version_has_hashes_and_no_host(name: str) -> None:
    text = (REPOSITORY / name).read_text(encoding="utf-8")
    locked = read_locked(name)
    assert len(locked) == text.count("==") - text.count(" == ") > 5
    assert "://" not in text
    assert all(re.fullmatch(r"(--hash=sha256:[0-9a-f]{64}\s*)+", hashes) for hashes in locked.values())


def test_the_tools_of_a_wheel_are_locked_like_those_of_development() -> None:
    build, dev = read_locked("requirements-build.txt"), read_locked("requirements-dev.txt")
    shared = {pin.partition("==")[0] for pin in dev} & {pin.partition("==")[0] for pin in build}
    assert {"cmake", "cython", "ninja", "numpy", "scikit-build-core"} <= shared
    versions = [{pin.partition(" ;")[0] for pin in pins if pin.partition("==")[0] in shared} for pins in (build, dev)]
    assert versions[0] == versions[1]


def test_the_recipe_for_conda_asks_for_what_the_project_asks_for() -> None:
    yaml = pytest.importorskip("ruamel.yaml")
    recipe = yaml.YAML(typ="safe").load((REPOSITORY / "recipe/recipe.yaml").read_text(encoding="utf-8"))
    project = PROJECT["project"]
    assert recipe["context"]["version"] == project["version"]
    run = {text.replace(" ", "").replace("matplotlib-base", "matplotlib") for text in recipe["requirements"]["run"]}
    assert run == {*project["dependencies"], "python" + project["requires-python"]}
    assert {text.replace(" ", "") for text in recipe["requirements"]["host"]} >= set(
        PROJECT["build-system"]["requires"]
    )
    assert recipe["build"]["python"]["entry_points"] == [f"{n} = {f}" for n, f in project["scripts"].items()]
    assert recipe["about"]["license_file"] == project["license-files"]


def test_a_wheel_with_tests_or_without_licences_is_refused(tmp_path: Path) -> None:
    good = ["pmfid/__init__.py", "pmfid-1.dist-info/licenses/LICENSE", "pmfid-1.dist-info/licenses/uPlot-LICENSE.txt"]
    good += ["pmfid-1.dist-info/sboms/pmfid.cdx.json", "pmfid/testing/contract.py"]
    cases = [(good, ""), ([*good, "pmfid/tests/test_a.py"], "tests"), ([*good, "studies/a.py"], "studies")]
    cases += [([*good, "pmfid/_kernel.pyx"], "pyx"), (good[:1], "LICENSE")]
    for names, wrong in cases:
        path = tmp_path / "a.whl"
        with zipfile.ZipFile(path, "w") as file:
            for name in names:
                file.writestr(name, "")
        if wrong:
            with pytest.raises(SystemExit, match=wrong):
                check_contents(path)
        else:
            check_contents(path)
