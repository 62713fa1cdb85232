"""Schedules that change gradually, the references, the command `simulate`, and the speed of the plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.pipeline.identify import identify
from pmfid.records.record import read_record
from pmfid.simulation import (
    CART,
    SCENARIOS,
    change_parameters,
    steps,
    stop_and_go,
    trapezoid,
)
from tests.command import run_command
from tests.conftest import long_unless

pytestmark = pytest.mark.usefixtures("without_judgement")

# --- schedules --------------------------------------------------------------------------------------------------------


def test_a_ramp_is_a_straight_line_between_steps() -> None:
    schedule = change_parameters(CART, 2.0, 4.0, mass=1.44)
    t = np.array([0.0, 1.99, 2.0, 3.0, 5.0, 6.0, 9.0])
    mass, viscous, *_ = schedule.sample(t, 0.01)
    assert mass == pytest.approx([1.07, 1.07, 1.07, 1.1625, 1.3475, 1.44, 1.44], abs=1e-8)
    assert viscous == pytest.approx(np.full(7, 12.8))


# --- references -------------------------------------------------------------------------------------------------------


def test_references_move_and_hold() -> None:
    jumps = steps(500, 0.01, 0.1, 1.0)
    assert jumps[[0, 99, 100, 199, 200]].tolist() == [0.1, 0.1, 0.0, 0.0, 0.1]
    cycle = stop_and_go(400, 0.01, 0.2, 1.0, 0.5, "trapezoid")
    np.testing.assert_allclose(cycle[:100], trapezoid(100, 0.01, 0.2, 1.0), atol=1e-12)
    with pytest.raises(ValueError, match="unknown shape 'spline'; choose one of: s-curve, trapezoid"):
        stop_and_go(400, 0.01, 0.2, 1.0, 0.5, "spline")


# --- the command ------------------------------------------------------------------------------------------------------


CHANGING = {name for name, recipe in SCENARIOS.items() if recipe.change != "constant"}


@pytest.mark.parametrize(
    "name", long_unless(lambda name: name in CHANGING or name in ("prbs", "stop-and-go"), SCENARIOS)
)
def test_identify_reads_every_scenario_and_finds_the_mass(name: str, tmp_path: Path) -> None:
    record = tmp_path / "run.csv"
    run_command("simulate", name, "--out", str(record), "--increments", "1024", "--bits", "12", "--seed", "2")
    axis = load_axis(tmp_path / "run.toml")
    found = identify(read_record(record, axis), axis)
    # all changes are relative to the present input gain: a slipping belt looks like more mass
    truth = {"mass-step": 1.44, "mass-ramp": 1.44, "slipping-belt": 1.07 / 0.8}.get(SCENARIOS[name].change, 1.07)
    assert found.theta[0] == pytest.approx(truth, rel=0.01)
    assert axis.estimator.forgetting == (0.995 if name in CHANGING else 1.0)
