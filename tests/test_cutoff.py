"""The choice of the filters' pole by the record."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.config.axis import load_axis
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.cutoff import choose_cutoff
from pmfid.estimators.tuning import TUNING
from pmfid.pipeline.monitored.setup import set_up
from pmfid.pipeline.result import Result
from pmfid.simulation import Machine
from pmfid.status import Status
from pmfid.types import Floats
from studies.machines import Axis, record_of, truth
from studies.real_axes import REAL
from tests.command import run_command

TOML = """\
[record]
input = "u"
output = "counts"
output_kind = "counts"
dt = {dt}
[encoder]
resolution = {resolution}
[model]
input_gain = {gain}
"""


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
        min(TUNING.cutoff_tried, key=lambda k: abs(k * result.estimator.cutoff * result.estimator.dt - 1))
    )


def test_filters_far_too_fast_for_the_encoder_are_not_chosen() -> None:
    """With three samples the mass of the mirror has an error of 26 % with its encoder."""
    axis = REAL["mirror"]
    record = record_of(axis, Machine(axis.drive), "stop-and-go", 4096, 11)
    model, encoder = pmfid.Drive(axis.drive.input_gain), pmfid.Encoder(record.resolution)
    fast = pmfid.IV(model, encoder, axis.dt, 1 / (3 * axis.dt))
    own = pmfid.IV(model, encoder, axis.dt, choose_cutoff([model], encoder, axis.dt, record.u, record.counts))
    mass = [method.settle_iteration(record.u, record.counts)[1][0] / axis.drive.mass for method in (fast, own)]
    assert abs(mass[0] - 1) > 0.05
    assert abs(mass[1] - 1) < 0.01


def test_without_motion_it_is_the_record_that_is_refused() -> None:
    rng, still = np.random.default_rng(0), np.zeros(900, dtype=np.int64)
    encoder, model = pmfid.Encoder(1e-3), pmfid.Drive(2.0)
    with pytest.raises(NotIdentifiableError, match="does not move"):
        pmfid.identify(rng.normal(size=900), still, model=model, encoder=encoder, dt=0.01)
    assert choose_cutoff([model], encoder, 0.01, rng.normal(size=900), still) == pytest.approx(
        1 / (TUNING.cutoff_tried[0] * 0.01)
    )


def test_an_equation_that_nothing_simulates_has_a_cutoff_too() -> None:
    """The direction is taken from the counts, and compensated least squares makes the choice."""
    axis = REAL["plotter"]
    record = record_of(axis, Machine(axis.drive), "prbs", 4096, 3)
    terms = (
        pmfid.Term("output", 2, "mass", "kg"),
        pmfid.Term("output", 1, "viscous_friction", "N s/m"),
        pmfid.Term("forward", 0, "coulomb_friction_forward", "N"),
    )
    model = pmfid.EquationModel(pmfid.Equation(terms, (pmfid.Term("input", 0, coefficient=3.5),)))
    assert model.equation.without_simulation
    encoder = pmfid.Encoder(record.resolution)
    cutoff = choose_cutoff([model], encoder, axis.dt, record.u, record.counts)
    result = pmfid.identify(record.u, record.counts, model=model, encoder=encoder, dt=axis.dt, method="bcls")
    assert result.estimator.cutoff == cutoff
    assert result["mass"] == pytest.approx(axis.drive.mass, rel=0.1)


def test_the_command_needs_none_and_export_asks_for_one_or_a_record(tmp_path: Path) -> None:
    axis = REAL["plotter"]
    record = record_of(axis, Machine(axis.drive), "prbs", 1024, 3)
    table = np.column_stack([record.u, record.counts])
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="u,counts", comments="", fmt=("%.9g", "%d"))
    toml = tmp_path / "axis.toml"
    toml.write_text(TOML.format(dt=axis.dt, resolution=record.resolution, gain=axis.drive.input_gain))
    paths = [str(tmp_path / "r.csv"), "--config", str(toml)]
    found = CliRunner().invoke(main, ["identify", *paths, "--json"])
    assert json.loads(found.stdout)["cutoff"] > 0
    export = ["export", str(toml), "--out", str(tmp_path / "c")]
    refused = CliRunner().invoke(main, export)
    assert "cutoff is missing" in refused.output
    run_command(*export, "--record", paths[0])


@pytest.mark.parametrize("name", ["crane", "door"])
def test_on_line_the_filters_settle_within_what_is_remembered(name: str) -> None:
    """For a record of many minutes, a recursion of two seconds would never trust its instruments with the preferred
    filters.
    """
    axis = replace(REAL[name], samples=30_000)
    record, forgetting = record_of(axis, Machine(axis.drive), "multisine", 256, 5), 1 - axis.dt / 2.0
    model, encoder = pmfid.Drive(axis.drive.input_gain), pmfid.Encoder(record.resolution)
    own = choose_cutoff([model], encoder, axis.dt, record.u, record.counts, forgetting)
    riv = pmfid.RIV(model, encoder, axis.dt, own, forgetting=forgetting)
    run = riv.run(record.u[:6000], record.counts[:6000])
    assert not np.any(run.status[3000:] & int(Status.FALLBACK))
    np.testing.assert_allclose(run.theta[3000:, 0], axis.drive.mass, rtol=0.05)


def test_a_monitor_has_filters_for_its_memory(tmp_path: Path) -> None:
    """AXIS.toml names neither pole nor memory here."""
    axis = replace(REAL["crane"], samples=30_000)
    record = record_of(axis, Machine(axis.drive), "multisine", 4096, 5)
    np.savetxt(
        tmp_path / "normal.csv",
        np.column_stack([record.u, record.counts]),
        header="u,counts",
        delimiter=",",
        comments="",
    )
    text = TOML.format(dt=axis.dt, resolution=record.resolution, gain=axis.drive.input_gain)
    (tmp_path / "axis.toml").write_text(text + '[monitor]\nreference = "normal.csv"\nmtbf_hours = 1.0\n')
    estimator = set_up(load_axis(tmp_path / "axis.toml"), tmp_path, None).monitor.estimator
    assert 1 / (estimator.cutoff * axis.dt) < 40
