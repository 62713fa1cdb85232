"""The study of accuracy: a reproducible page, right plants, a right bound, and right counts of cases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmfid.errors import UsageError
from pmfid.simulation import CART, CART_DT, Machine, drive_machine, make_scenario, quantize, simulate_drive
from studies import accuracy, open_loop, starts, stop_and_go, wrong_models
from studies.paper import truth
from studies.paper.truth import TRUTH, Outcome, cramer_rao, estimate, percent, positions, scenario_record
from studies.wrong_plants import PLANTS, wrong_record

# --- the page ---------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_page_has_the_section_that_was_asked_for(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    assert accuracy.main(["--out", str(page), "--seeds", "1", "--jobs", "1", "--only", "starts"]) == 0
    text = page.read_text(encoding="utf-8")
    assert "    python -m studies.accuracy --out results/accuracy.md --seeds 1 --only starts\n" in text
    assert "## How wrong a start may be" in text
    assert "## Open loop" not in text
    assert not any(line != line.rstrip() for line in text.splitlines())


@pytest.mark.parametrize(("option", "value"), [("--seeds", "0"), ("--jobs", "-1")])
def test_a_wrong_number_is_one_error(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert accuracy.main(["--out", "never.md", option, value]) == 2
    assert f"{option[2:]} must be at least 1, got {value}" in capsys.readouterr().err
    assert not Path("never.md").exists()


@pytest.mark.parametrize("name", list(accuracy.STUDIES))
def test_every_section_has_the_tasks_of_its_seeds(name: str) -> None:
    few, more = (accuracy.STUDIES[name].tasks(seeds) for seeds in (1, 2))
    assert len(set(few)) == len(few)
    assert set(few) < set(more)
    assert len(more) == 2 * len(few)


def test_run_refuses_no_seeds() -> None:
    with pytest.raises(UsageError, match="seeds"):
        accuracy.run(0)


# --- the bound --------------------------------------------------------------------------------------------------------


def test_positions_are_those_of_the_exact_simulation() -> None:
    u = make_scenario("prbs", seed=3).motion.u
    assert positions(u, TRUTH, 0.0) == pytest.approx(simulate_drive(CART, u, CART_DT).x, abs=1e-7)
    assert positions(u, TRUTH, 0.1) == pytest.approx(simulate_drive(CART, u, CART_DT, v0=0.1).x, abs=1e-7)


def test_bound_scales_with_the_step_and_falls_with_the_length() -> None:
    u = make_scenario("prbs", seed=3).motion.u
    bound = cramer_rao(u, 1e-4)
    assert cramer_rao(u, 5e-5) == pytest.approx(bound / 4)
    assert np.all(cramer_rao(u[:1500], 1e-4) > bound)


def test_bound_is_the_scatter_of_a_fit_to_white_noise() -> None:
    u, sigma = make_scenario("prbs", seed=3).motion.u, 1e-3
    step = 1e-4 * TRUTH
    sides = [[positions(u, TRUTH + way * step * (np.arange(3) == j), 0.0) for way in (1, -1)] for j in range(3)]
    starts_ = [np.ones_like(u), (positions(u, TRUTH, 1e-4) - positions(u, TRUTH, -1e-4)) / 2e-4]
    columns = np.column_stack([*((a - b) / (2 * h) for (a, b), h in zip(sides, step, strict=True)), *starts_])
    noise = sigma * np.random.default_rng(0).standard_normal((u.size, 2000))
    scatter = np.linalg.lstsq(columns, noise)[0][:3].var(axis=1)
    assert cramer_rao(u, sigma * np.sqrt(12)) == pytest.approx(scatter, rel=0.1)


# --- wrong plants -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", ["prbs", "stop-and-go"])
def test_the_right_plant_moves_as_the_exact_one(scenario: str) -> None:
    record, exact = wrong_record(Machine(CART), scenario, 2, 1024), scenario_record(scenario, 2, 1024)
    assert record.resolution == exact.resolution
    difference = np.abs(record.counts - exact.counts)
    assert difference.max() <= (1 if scenario == "prbs" else 3)  # the control loop passes a difference of a count on
    assert difference.mean() < 0.1
    assert np.ptp(exact.counts) > 1000


def moved(plant: Machine, volts: float, samples: int = 300) -> tuple[float, float]:
    run = drive_machine(plant, np.full(samples, volts), CART_DT, 1e-6)
    return float(run.x[-1]), float(run.v[-1])


def test_each_wrong_plant_does_what_it_says() -> None:
    assert moved(PLANTS["Stribeck friction"], 0.59) == (0.0, 0.0)  # 1.18 N against 1.2 N at rest
    assert moved(PLANTS["Stribeck friction"], 0.61)[1] > 0
    assert moved(PLANTS["Stribeck friction"], 0.75)[1] == pytest.approx((1.5 - 0.8) / 12.8, rel=0.01)
    assert moved(PLANTS["nothing"], 0.59)[1] == pytest.approx((1.18 - 0.8) / 12.8, rel=1e-6)
    v = moved(PLANTS["quadratic friction"], 3.0)[1]
    assert 0.8 + 12.8 * v + 6.4 * v**2 == pytest.approx(6.0, rel=1e-6)
    assert moved(PLANTS["input gain"], 3.0)[1] == pytest.approx((6.6 - 0.8) / 12.8, rel=1e-6)
    x, v = moved(PLANTS["load spring"], -3.0, 3000)
    assert v == pytest.approx(0.0, abs=1e-4)
    assert 5 * x == pytest.approx(-5.2, abs=1e-3)
    for name, delay in (("input delay", 0.005), ("small input delay", 0.001)):
        late = drive_machine(PLANTS[name], [3.0, 3.0], CART_DT, 1e-6).v[1]
        assert late == pytest.approx(5.2 / 12.8 * (1 - np.exp(-12.8 / 1.07 * (0.01 - delay))), rel=1e-6)


def test_a_plant_stops_where_the_exact_one_stops() -> None:
    u = np.r_[np.full(20, 3.0), np.zeros(50)]
    run = drive_machine(Machine(CART), u, CART_DT, 1e-6)
    assert run.x == pytest.approx(simulate_drive(CART, u, CART_DT).x, abs=2e-7)
    assert run.v[-1] == 0.0


# --- the sections' own counting ---------------------------------------------------------------------------------------


def test_iv_is_right_where_the_page_says_so() -> None:
    theta = estimate("iv", scenario_record("prbs", 0, 1024)).theta
    assert np.all(np.abs(percent(theta)) < [0.3, 1.0, 4.0])
    found = stop_and_go.work(3, 1024, 0)
    assert np.all(np.abs(found["iv"]["error"]) < [0.3, 1.0, 4.0])
    assert found["riv"]["error"].shape == (2000, 3)


def test_the_check_of_iv_can_fail() -> None:
    def line(mass: float) -> str:
        cells = {(2, 4096): [{"iv": TRUTH}], (3, 128): [{"iv": TRUTH * [mass, 1.0, 1.0]}]}
        return open_loop._goal(cells)[0]

    assert "**not met**" in line(0.996)
    assert "-0.400 %" in line(0.996)
    assert "Tf = 3 T, 128 increments" in line(1.002)
    assert ": met" in line(1.002)


def test_starts_are_wrong_by_their_factor() -> None:
    assert starts.start_of("none given", 1.0) is None
    truth_by_name = dict(zip(truth.NAMES, TRUTH.tolist(), strict=True))
    assert starts.start_of("none wrong", 1.0) == truth_by_name
    assert starts.start_of("mass", 4.0) == truth_by_name | {"mass": 4 * 1.07}
    assert starts.start_of("all", 0.5) == {name: value / 2 for name, value in truth_by_name.items()}


def test_samples_astray_without_a_warning_are_counted() -> None:
    near = starts.work("stop-and-go", 1024, "none wrong", 1.0, 0)
    far = starts.work("stop-and-go", 1024, "mass", 4.0, 0)
    assert near["riv"]
    assert near["until"] < far["until"]
    assert 0 <= far["unsaid"] <= far["until"] - far["starting"] + 1e-9


def test_a_record_without_motion_is_an_outcome() -> None:
    still = truth.CartRecord(np.ones(500), quantize(np.zeros(500), 1e-4), 1e-4)
    outcome = estimate("iv", still, judged=True)
    assert outcome.failure == "NotIdentifiableError"
    assert np.all(np.isnan(outcome.theta))
    moving = scenario_record("prbs", 0, 1024)
    short = truth.CartRecord(moving.u[:20], moving.counts[:20], moving.resolution)
    assert estimate("riv", short, judged=True).failure == "still starting"
    assert wrong_models._error([outcome]) == ["no estimate"]
    assert wrong_models._error([outcome, Outcome(TRUTH * 1.01, TRUTH)]) == ["+1.00, +1.00, +1.00"]


def test_a_table_and_a_tally() -> None:
    assert truth.table(["a", "b"], [["1", "2"]]) == ["| a | b |", "|---|---|", "| 1 | 2 |", ""]
    assert truth.tally([("x", "y"), ("x",), ()]) == "x 2/3, y 1/3"
    assert truth.tally([(), ()]) == "–"
