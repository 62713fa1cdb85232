"""`pmfid selftest`: good results pass, and wrong models or too little motion are reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pmfid.cli.main import main
from pmfid.simulation import DriveParameters, Machine, drive_machine, prbs
from pmfid.types import Floats
from tests.command import counted_axis

DT, STEP = 0.005, 5e-5
DRIVE = DriveParameters(mass=0.8, viscous_friction=4.0, coulomb_friction=0.5, input_gain=1.5)
TOML = counted_axis(0.005, 5e-5, 1.5)


def write_record(folder: Path, u: Floats, machine: Machine, seed: int = 0) -> tuple[str, str]:
    """Write a record and AXIS.toml, and return their paths."""
    run = drive_machine(machine, u, DT, STEP, phase=STEP * np.random.default_rng(seed).random())
    np.savetxt(folder / "run.csv", np.column_stack([u, run.counts]), "%.17g", ",", header="u,counts", comments="")
    (folder / "axis.toml").write_text(TOML)
    return str(folder / "run.csv"), str(folder / "axis.toml")


def call(*words: str, code: int = 0) -> Result:
    result = CliRunner().invoke(main, words)
    assert result.exit_code == code, result.output
    return result


def run_selftest(folder: Path, u: Floats, machine: Machine, seed: int = 0, runs: int = 3) -> dict[str, object]:
    """Identify a record, test the result, and return what `--json` prints."""
    record, axis = write_record(folder, u, machine, seed)
    call("identify", record, "--config", axis, "--out", str(folder / "out"))
    words = (record, "--config", axis, "--model", str(folder / "out" / "result.json"), "--runs", str(runs))
    return dict(json.loads(call("selftest", *words, "--json").stdout))


def draw_input(seed: int, samples: int = 1000) -> Floats:
    rng = np.random.default_rng([seed, 5])
    return prbs(samples, clock=20, amplitude=5.0, rng=rng)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_good_result_is_recovered(tmp_path: Path, seed: int) -> None:
    found = run_selftest(tmp_path, draw_input(seed), Machine(DRIVE), seed)
    assert found["status"] == []
    assert found["coverage"] >= 0.7  # type: ignore[operator]
    mass = found["parameters"]["mass"]  # type: ignore[index]
    assert mass["value"] == pytest.approx(0.8, rel=0.01)
    assert 0 < mass["rmse"] < 0.01


@pytest.mark.parametrize(
    "machine",
    [
        Machine(DRIVE, stribeck=1.0, stribeck_speed=0.1),
        pytest.param(Machine(DRIVE, stiffness=4.0), marks=pytest.mark.long),
        pytest.param(Machine(DRIVE, dead_time=0.005), marks=pytest.mark.long),
    ],
)
def test_a_wrong_model_is_reported(tmp_path: Path, machine: Machine) -> None:
    assert run_selftest(tmp_path, draw_input(3), machine)["status"]


def test_too_little_motion_is_reported(tmp_path: Path) -> None:
    record, axis = write_record(tmp_path, 0.53 * np.sign(draw_input(4, samples=50)), Machine(DRIVE))
    values = {"mass": 0.8, "viscous_friction": 4.0, "coulomb_friction": 0.5}
    content = {"model": "drive", "parameters": {name: {"value": value} for name, value in values.items()}}
    (tmp_path / "guess.json").write_text(json.dumps(content))
    words = (record, "--config", axis, "--model", str(tmp_path / "guess.json"), "--runs", "2", "--json")
    found = json.loads(call("selftest", *words).stdout)
    assert "poor_excitation" in found["status"]
    assert {"refused", "uncertain"} & set(found["status"])


def test_a_result_of_another_model_is_refused(tmp_path: Path) -> None:
    record, axis = write_record(tmp_path, draw_input(6), Machine(DRIVE))
    (tmp_path / "other.json").write_text('{"model": "transfer_function", "parameters": {"a0": {"value": 1.0}}}')
    result = call("selftest", record, "--config", axis, "--model", str(tmp_path / "other.json"), code=2)
    assert "kind" in result.stderr
