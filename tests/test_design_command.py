"""`pmfid design`, before and after the first run, as a new user tries it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.design.body import simulate
from pmfid.pipeline.designs import load_spec, make_problem
from tests.command import run_command

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "cart_design.toml"
FEW = ("--set", "search.starts=3", "--certify", "0")


def changed(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "spec.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder of the example's design, and the printed text."""
    out = tmp_path_factory.mktemp("design")
    result = run_command("design", EXAMPLE, *FEW, "--out", out)
    return out, result.stdout


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Return the input of the first design of a commissioning."""
    out = tmp_path_factory.mktemp("first")
    run_command("design", EXAMPLE, "--want", "mass=1e-6", "--set", "search.starts=3", "--out", out)
    return pl.read_csv(out / "design.csv")["u"].to_numpy()[:-1]


def test_json_is_the_object_that_was_promised() -> None:
    result = run_command(
        "design", EXAMPLE, "--set", "experiment.unknown=['mass']", "--set", "experiment.criterion=trace", "--json", *FEW
    )
    found = json.loads(result.stdout)
    assert {"bound", "gap", "standard", "predicted_std_encoder", "solve_seconds", "warnings"} <= set(found)
    assert found["criterion"] == "trace"
    assert found["starts"] == 3
    assert found["feasible"] is True
    assert found["gain"]["trapezoid"] == pytest.approx(found["value"] / found["standard"]["trapezoid"])
    assert found["gain"]["trapezoid"] > 1.2
    assert found["surviving"] > 0.99
    # the trace for one scaled parameter is (nominal / std)^2
    assert found["predicted_std"] == {"mass": pytest.approx(1.5 / np.sqrt(found["value"]))}
    assert found["recommended"] in {"design", *found["standard"]}
    assert result.stderr == ""


def test_the_table_shows_design_and_standard_inputs(folder: tuple[Path, str]) -> None:
    out, printed = folder
    for word in ("design", "trapezoid", "minimum time", "multisine", "Coulomb friction", "report.html"):
        assert word in printed
    motion = pl.read_csv(out / "design.csv")
    assert motion.columns == ["t", "u", "x", "v"]
    assert motion["x"][-1] == pytest.approx(0.4, abs=1e-9)
    assert motion["t"].to_list() == pytest.approx(np.linspace(0, 2, 41))
    assert (out / "trapezoid.csv").exists()
    page = (out / "report.html").read_text(encoding="utf-8")
    for heading in ("Value of the design", "Input and motion"):
        assert heading in page
    assert page.count("<figure") == 1
    assert "http" not in page
    saved = json.loads((out / "design.json").read_text())
    assert saved["criterion"] == "D"


def test_limits_that_cannot_be_met_say_what_to_relax(tmp_path: Path) -> None:
    path = changed(tmp_path, ("duration = 2.0", "duration = 0.5"))
    result = run_command("design", path, "--set", "experiment.unknown=['mass']", *FEW, code=3)
    assert result.stdout == ""
    assert "relax one of" in result.stderr
    assert "least time" in result.stderr
    assert result.stderr.count("\n") == 1
    machine = run_command("design", path, "--set", "experiment.unknown=['mass']", *FEW, "--json", code=3)
    found = json.loads(machine.stdout)
    assert found["feasible"] is False
    assert found["relax"]
    assert all(np.isfinite(way["to"]) for way in found["relax"])


def record(tmp_path: Path, u: np.ndarray, mass: float) -> Path:
    """Write a run of this input on an axis with this mass, sampled faster than the design."""
    problem = make_problem(load_spec(EXAMPLE, {"encoder.samples_per_interval": 5}))
    motion = simulate(problem, u, {"mass": mass})
    counts = np.floor(motion.x / 22.75e-6 + 0.4).astype(int)
    path = tmp_path / "run.csv"
    pl.DataFrame({"t": motion.t, "u": motion.u, "counts": counts}).write_csv(path)
    return path


def test_a_recorded_run_is_estimated_and_the_next_one_designed(tmp_path: Path, first: np.ndarray) -> None:
    path = record(tmp_path, first, 1.6)
    result = run_command("design", EXAMPLE, path, "--set", "search.starts=3", "--json", "--out", tmp_path / "next")
    found = json.loads(result.stdout)
    mass = found["rounds"][-1]["parameters"]["mass"]
    assert mass["value"] == pytest.approx(1.6, rel=1e-4)
    assert abs(mass["value"] - 1.6) < 5 * mass["std"]
    assert mass["interval"][0] < mass["value"] < mass["interval"][1]
    assert set(found["next"]["expected_std"]) == {"mass", "viscous_friction", "coulomb_friction"}
    assert found["doubts"] == []
    assert found["next"]["predicted_std"]["mass"] < mass["std"]
    assert pl.read_csv(tmp_path / "next" / "design.csv")["x"][-1] == pytest.approx(0.4, abs=1e-9)
    done = run_command("design", EXAMPLE, path, path, "--want", "mass=0.01", "--json")
    assert json.loads(done.stdout)["reached"] is True
    assert json.loads(done.stdout)["next"] is None
    assert "every wanted deviation is reached" in run_command("design", EXAMPLE, path, "--want", "mass=0.01").stdout


@pytest.mark.long
def test_all_rounds_on_a_simulated_axis() -> None:
    options = ("--truth", "mass=1.8", "--want", "mass=1e-9", "--rounds", "2", "--set", "search.starts=3")
    result = run_command("design", EXAMPLE, *options, "--json")
    found = json.loads(result.stdout)
    assert found["reached"] is False
    assert len(found["rounds"]) == 2
    assert found["rounds"][1]["parameters"]["mass"]["value"] == pytest.approx(1.8, rel=1e-3)
    assert found["rounds"][1]["travel"] == pytest.approx(0.4, rel=0.02)
    assert re.search(r"1\.(80|79)\d* ±", run_command("design", EXAMPLE, *options).stdout)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "experiment.criterion=Q"], "criterion = 'Q' (given as an option)"),
        (["--certify", "-1"], "certify"),
        (["--want", "mass"], "not NAME=NUMBER"),
        (["--want", "offset=1"], "offset is none of the unknown"),
        (["--want", "mass=-1"], "positive"),
        (["--truth", "weight=1"], "weight is not a parameter"),
        (["nowhere.csv"], "nowhere.csv"),
    ],
)
def test_wrong_use_is_one_error(arguments: list[str], message: str) -> None:
    result = run_command("design", EXAMPLE, *arguments, code=2)
    assert message in result.stderr


def test_the_page_example_in_python_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/howto/design.md").read_text("utf-8"), re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["mass"] == pytest.approx(1.8, rel=1e-3)
