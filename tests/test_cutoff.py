"""The choice of the filters' pole by the record."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.estimators.cutoff import CUTOFF_TRIED
from pmfid.pipeline.result import Result
from pmfid.simulation import Machine
from pmfid.types import Floats
from studies.machines import Axis, record_of, truth
from studies.real_axes import REAL
from tests.command import counted_axis, run_command

pytestmark = pytest.mark.usefixtures("without_judgement")


def identified(axis: Axis, motion: str, cutoff: float | None = None, **settings: object) -> tuple[Floats, Result]:
    """Return the relative errors (3,) and the result."""
    record = record_of(axis, Machine(axis.drive), motion, 4096, 11)
    encoder, model = pmfid.Encoder(record.resolution), pmfid.Drive(axis.drive.input_gain)
    result = pmfid.identify(
        record.u, record.counts, model=model, encoder=encoder, dt=axis.dt, cutoff=cutoff, **settings
    )
    return result.theta / truth(axis) - 1, result


@pytest.mark.parametrize("name", ["wheel", "plotter", "crane"])
def test_no_setting_of_the_estimator_is_needed(name: str) -> None:
    """The axes range from 2.6e-5 kg m2 every millisecond to 500 kg every 20 ms."""
    error, result = identified(REAL[name], "prbs", method="iv")
    assert abs(error[0]) < 5e-3
    assert any("was chosen for this record" in note for note in result.notes)
    assert 1 / (result.estimator.cutoff * result.estimator.dt) == pytest.approx(
        min(CUTOFF_TRIED, key=lambda k: abs(k * result.estimator.cutoff * result.estimator.dt - 1))
    )


def test_the_command_needs_none_and_export_asks_for_one_or_a_record(tmp_path: Path) -> None:
    axis = REAL["plotter"]
    record = record_of(axis, Machine(axis.drive), "prbs", 1024, 3)
    table = np.column_stack([record.u, record.counts])
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="u,counts", comments="", fmt=("%.9g", "%d"))
    toml = tmp_path / "axis.toml"
    toml.write_text(counted_axis(axis.dt, record.resolution, axis.drive.input_gain))
    paths = [str(tmp_path / "r.csv"), "--config", str(toml)]
    assert json.loads(run_command("identify", *paths, "--json").stdout)["cutoff"] > 0
    export = ["export", str(toml), "--out", str(tmp_path / "c")]
    assert "cutoff is missing" in run_command(*export, code=2).output
    run_command(*export, "--record", paths[0])
