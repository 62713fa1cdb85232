"""The search for the terms of a drive: the terms that it names or leaves out, its table, its files and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.pipeline.terms import TermSearch
from pmfid.simulation import DriveParameters, Machine, drive_machine, prbs
from pmfid.simulation.drive import MachineRun
from tests.command import run_command

DT, GAIN, STEP = 0.002, 0.5, 2 * np.pi / 1024
DRIVE = DriveParameters(3e-3, 8e-3, 0.04, GAIN)
MODEL = pmfid.Drive(GAIN, axis="rotary")


def made(samples: int = 1000, **lacking: float) -> MachineRun:
    """Return a record of a rotary axis under a binary input."""
    rng = np.random.default_rng(11)
    u = prbs(samples, clock=25, amplitude=0.7, rng=rng)
    return drive_machine(Machine(DRIVE, **lacking), u, DT, STEP, phase=STEP * rng.random())


def searched(record: MachineRun, model: object = MODEL, **settings: object) -> TermSearch:
    own = {"model": model, "dt": DT, "encoder": pmfid.Encoder(STEP)}
    return pmfid.search_terms(record.u, record.counts, **(own | settings))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def directional() -> TermSearch:
    return searched(made(asymmetry=0.15))


def test_nothing_is_named_where_nothing_is_missing() -> None:
    found = searched(made())
    assert (found.added, found.status, found.model) == ({}, (), MODEL)
    assert "no further term" in found.sentence
    assert not any(row.chosen for row in found.rows)
    assert {"a constant load", "Stribeck friction", "quadratic friction"} <= {row.words for row in found.rows}


@pytest.mark.parametrize(
    ("lacking", "wanted"),
    [
        ({"quadratic": 3e-4}, {"quadratic": True}),
        ({"gravity": 0.02, "gravity_angle": 0.4}, {"gravity": True}),
        (
            {"stribeck": 0.02, "stribeck_speed": 0.6, "dead_time": 1e-3},
            {"stribeck": "estimate", "dead_time": "estimate"},
        ),
    ],
)
def test_a_term_is_named_and_the_result_has_it(lacking: dict[str, float], wanted: dict[str, object]) -> None:
    found = searched(made(1000, **lacking))
    assert found.added == wanted
    assert found.result["inertia"] == pytest.approx(DRIVE.mass, rel=1e-3)
    assert {key: getattr(found.model, key) for key in wanted} == wanted


def test_directional_friction_contains_the_load(directional: TermSearch) -> None:
    assert directional.added == {"friction": "directional"}
    assert directional.result["coulomb_friction_forward"] == pytest.approx(1.15 * DRIVE.coulomb_friction, rel=0.01)
    assert 'friction = "directional"' in directional.lines
    assert directional.status == ()


def test_the_command_says_what_python_says(directional: TermSearch, tmp_path: Path) -> None:
    record, table, axis, out = made(asymmetry=0.15), tmp_path / "run.csv", tmp_path / "axis.toml", tmp_path / "out"
    rows = [f"{DT * i:.9g},{u:.12g},{c}" for i, (u, c) in enumerate(zip(record.u, record.counts, strict=True))]
    table.write_text("\n".join(["t,u,counts", *rows]))
    axis.write_text(
        '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ntime = "t"\n'
        f'[encoder]\nresolution = {STEP}\n[model]\naxis = "rotary"\ninput_gain = {GAIN}\n'
    )
    command = ["terms", str(table), "--config", str(axis)]
    result = run_command(*command, "--json", "--out", str(out))
    printed = json.loads(result.stdout)
    assert printed["added"] == directional.added
    assert json.loads((out / "terms.json").read_text()) == printed
    assert "<pre>[model]" in (out / "terms.html").read_text()
    shown = CliRunner().invoke(main, command).stdout
    assert directional.sentence in shown
    assert "status: none" in shown
    for further, said in ((["--set", "estimator.cutoff=-1"], "cutoff"), (["--out", str(table)], "run.csv")):
        refused = run_command(*command, *further, code=2)
        assert said in refused.stderr
