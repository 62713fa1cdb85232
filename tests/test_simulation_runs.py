"""Schedules that change gradually, the references, the command `simulate`, and the speed of the plant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.pipeline.identify import identify
from pmfid.records.record import read_record
from pmfid.simulation import (
    CART,
    SCENARIOS,
    Faults,
    Schedule,
    change_parameters,
    make_scenario,
    prbs,
    random_moves,
    simulate_drive,
    steps,
    stop_and_go,
    trapezoid,
)
from tests.command import run_command
from tests.conftest import long_unless
from tests.refusals import refused

HEAVY = replace(CART, mass=1.44)


# --- schedules --------------------------------------------------------------------------------------------------------


def test_a_ramp_is_a_straight_line_between_steps() -> None:
    schedule = change_parameters(CART, 2.0, 4.0, mass=1.44)
    t = np.array([0.0, 1.99, 2.0, 3.0, 5.0, 6.0, 9.0])
    mass, viscous, *_ = schedule.sample(t, 0.01)
    assert mass == pytest.approx([1.07, 1.07, 1.07, 1.1625, 1.3475, 1.44, 1.44], abs=1e-8)
    assert viscous == pytest.approx(np.full(7, 12.8))


def test_a_ramp_of_one_sample_is_a_step() -> None:
    u = prbs(300, clock=7, amplitude=3.0, rng=np.random.default_rng(2))
    step = simulate_drive(Schedule(((0.0, CART), (1.0, HEAVY))), u, 0.01)
    ramp = simulate_drive(Schedule(((0.0, CART), (0.99, HEAVY)), (0.0, 0.01)), u, 0.01)
    np.testing.assert_allclose(ramp.x, step.x, rtol=0, atol=1e-9)


def test_friction_and_belt() -> None:
    worn = change_parameters(CART, 1.0, 1.0, viscous_friction=19.2, coulomb_friction=1.2)
    _, viscous, coulomb, gain, _ = worn.sample([0.5, 1.5, 3.0], 0.01)
    assert viscous == pytest.approx([12.8, 16.0, 19.2])
    assert coulomb == pytest.approx([0.8, 1.0, 1.2])
    assert gain == pytest.approx([2.0, 2.0, 2.0])
    assert change_parameters(CART, 1.0, input_gain=1.6).sample([0.5, 1.0], 0.01)[3].tolist() == [2.0, 1.6]


def test_ramps_that_overlap_or_never_end_are_refused() -> None:
    def ramped(*ramps: float) -> Schedule:
        return Schedule(((0.0, CART), (1.0, HEAVY), (2.0, CART))[: max(2, len(ramps))], ramps)

    refused(
        (r"one time per change, the first 0, got \(0.0,\)", lambda: ramped(0.0)),
        (r"one time per change, the first 0, got \(1.0, 0.0\)", lambda: ramped(1.0, 0.0)),
        ("ramp must be >= 0 and end before the next change, got -1.0", lambda: ramped(0.0, -1.0)),
        ("end before the next change, got 2.0", lambda: ramped(0.0, 2.0, 0.0)),
        ("got nan; give a time in s", lambda: ramped(0.0, float("nan"))),
        kind=ValueError,
    )


# --- references -------------------------------------------------------------------------------------------------------


def test_references_move_and_hold() -> None:
    jumps = steps(500, 0.01, 0.1, 1.0)
    assert jumps[[0, 99, 100, 199, 200]].tolist() == [0.1, 0.1, 0.0, 0.0, 0.1]
    cycle = stop_and_go(400, 0.01, 0.2, 1.0, 0.5, "trapezoid")
    np.testing.assert_allclose(cycle[:100], trapezoid(100, 0.01, 0.2, 1.0), atol=1e-12)
    with pytest.raises(ValueError, match="unknown shape 'spline'; choose one of: s-curve, trapezoid"):
        stop_and_go(400, 0.01, 0.2, 1.0, 0.5, "spline")


def test_random_moves_join_and_stay_in_the_stroke() -> None:
    x = random_moves(20_000, 0.01, 0.4, 0.8, 0.5, np.random.default_rng(3))
    assert x[0] == 0.0
    assert x.min() >= 0.0
    assert x.max() <= 0.4
    assert np.abs(np.diff(x)).max() <= 0.01 * 1.875 * 0.4 / 0.8
    resting = np.diff(x) == 0.0
    assert np.mean(resting) == pytest.approx(0.5 / 1.3, abs=0.05)
    moves = np.flatnonzero(~resting[1:] & resting[:-1]).size
    assert moves == pytest.approx(200 / 1.3, rel=0.1)


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


def test_truth_columns_are_the_truth(tmp_path: Path) -> None:
    record = tmp_path / "run.csv"
    run_command("simulate", "stop-and-go-slipping-belt", "--out", str(record), "--truth", "--duration", "4")
    header, *rows = record.read_text().splitlines()
    assert header == "t,u,counts,x,v,mass,viscous_friction,coulomb_friction,input_gain,offset"
    values = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    motion = make_scenario("stop-and-go-slipping-belt", duration=4.0).motion
    np.testing.assert_array_equal(values[:, 3], motion.x)
    assert values[[0, 199, 200], 8].tolist() == [2.0, 2.0, 1.6]


def test_faults_reach_the_record(tmp_path: Path) -> None:
    plain, faulty = tmp_path / "a.csv", tmp_path / "b.csv"
    options = ["--duration", "5", "--increments", "512"]
    run_command("simulate", "prbs", "--out", str(plain), *options)
    worse = ["--missed", "0.01", "--jitter", "0.1", "--line-error", "0.2"]
    run_command("simulate", "prbs", "--out", str(faulty), *options, *worse)
    made = make_scenario("prbs", duration=5.0, increments=512, faults=Faults(0.01, 0.1, 0.2, 512, 0))
    counts = [int(row.split(",")[2]) for row in faulty.read_text().splitlines()[1:]]
    assert counts == made.counts.tolist()
    assert plain.read_text() != faulty.read_text()


def test_list_names_every_scenario() -> None:
    result = run_command("simulate", "--list")
    assert [line.split()[0] for line in result.output.splitlines()] == list(SCENARIOS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give a scenario and --out RUN.csv"),
        (["prbs"], "give a scenario and --out RUN.csv"),
        (["stop-and-goo", "--out", "x.csv"], "unknown scenario 'stop-and-goo'; did you mean 'stop-and-go'?"),
        (["prbs", "--out", "x.parquet"], "the record is written as CSV, not as 'x.parquet'; name it x.csv"),
        (["prbs", "--out", "x.csv", "--missed", "1"], r"missed must be in [0, 1), got 1.0"),
        (["prbs", "--out", "x.csv", "--duration", "0"], "duration must be finite and > 0.01"),
        (["prbs", "--out", "x.csv", "--duration", "nan"], "duration must be finite and > 0.01"),
    ],
)
def test_bad_usage_is_one_error(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run_command("simulate", *arguments, code=2)
    assert message in result.output
    assert len(result.output.splitlines()) == 1
    assert not list(Path().iterdir())
