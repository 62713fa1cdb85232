"""The figures of the paper: their numbers, their pictures, their data, the command."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.colors import to_hex

from pmfid.errors import UsageError
from pmfid.estimators.auto import choose, first_choice
from pmfid.report.figures import COLOURS, MAGENTA
from pmfid.simulation import CART, make_scenario
from studies.paper import encoders, figure2, figure3, figure4, figure5
from studies.paper.__main__ import main
from studies.paper.drawing import Drawing, draw, write_drawing
from studies.paper.estimates import EXTENDED, mass_of, record_of, track_of
from studies.paper.inputs import STROKE, designed, experiments, information, problem, pulse
from studies.paper.merit import HEADER, NO_ANSWER, Merit, cells, merit, score, write_table
from studies.paper.page import GOALS, sections
from studies.paper.run import FIGURES, reproduce
from studies.paper.truth import make_estimator

ROOT = Path(__file__).parents[1]


# --- figures of merit -------------------------------------------------------------------------------------------------


def test_merit_is_the_statistics_of_all_samples_of_all_runs() -> None:
    rng = np.random.default_rng(0)
    values, truth, std = 2.0 + 0.1 * rng.standard_normal((50, 40)), 2.1, np.full(40, 0.1)
    row = merit("3", "c", "m", 512, [score(run, std, truth) for run in values])
    assert (row.runs, row.refused) == (50, 0)
    assert row.bias == pytest.approx(100 * (values.mean() / truth - 1))
    assert row.std == pytest.approx(100 * values.std() / truth)
    assert row.rms == pytest.approx(100 * np.sqrt(np.mean((values / truth - 1) ** 2)))
    assert row.coverage == pytest.approx(100 * np.mean(np.abs(values - truth) < 0.196))
    assert math.isnan(row.settled)


def test_intervals_of_the_right_width_cover_95_percent() -> None:
    rng = np.random.default_rng(1)
    row = merit("3", "c", "m", 512, [score(rng.normal(1.0, 0.1, 100), np.full(100, 0.1), 1.0) for _ in range(200)])
    assert row.coverage == pytest.approx(95.0, abs=0.5)


@pytest.mark.parametrize(
    ("times", "median"),
    [([1.0, 9.0, 2.0], 2.0), ([1.0, 2.0], 1.5), ([1.0, math.inf, math.inf], math.inf), ([math.nan], math.nan)],
)
def test_median_of_times_that_may_never_come(times: list[float], median: float) -> None:
    one = np.ones(1)
    row = merit("5", "c", "m", 512, [score(one, one, 1.0, time) for time in times])
    assert row.settled == pytest.approx(median, nan_ok=True)


def test_runs_without_an_estimate_are_counted_and_left_out() -> None:
    good = score(np.array([1.1]), np.array([1.0]), 1.0)
    row = merit("3", "c", "m", 512, [good, NO_ANSWER])
    assert (row.runs, row.refused) == (2, 1)
    assert row.bias == pytest.approx(10.0)
    assert math.isnan(merit("3", "c", "m", 512, [NO_ANSWER]).bias)


def test_table_reads_back(tmp_path: Path) -> None:
    rows = [Merit("3", "stop-and-go, 1 kg", "rls", 512, 2, bias=1 / 3, settled=math.inf), Merit("2", "d", "m", 1, 1)]
    write_table(rows, tmp_path / "table.csv")
    with open(tmp_path / "table.csv", newline="") as file:
        first, second = csv.DictReader(file)
    assert float(first["bias"]) == 1 / 3
    assert (first["condition"], first["settled"], first["std"]) == ("stop-and-go, 1 kg", "inf", "")
    assert second["bias"] == ""
    assert dict(zip(HEADER, cells(rows[0]), strict=True))["settled [s]"] == "never"


# --- estimates --------------------------------------------------------------------------------------------------------


def test_auto_is_what_is_chosen() -> None:
    record = record_of(make_scenario("moves", seed=1, increments=512, duration=8.0))
    plain = make_estimator("ls", record)
    found = first_choice(plain, record.u, record.counts)
    estimator, reason, fit = found.estimator, found.reason, found.fit
    assert (estimator.method, reason) == (choose(plain, record.u, record.counts, 1.0)[0].method, reason)
    assert fit.theta.tolist() == estimator.fit(record.u, record.counts).theta.tolist()
    assert mass_of("auto", record, 3) == (fit.theta[0], fit.theta_std[0])
    riv, auto = (track_of(m, record, 3, 0.99) for m in ("riv", "auto"))
    np.testing.assert_array_equal(auto.theta, riv.theta)


def test_extended_rls_is_the_biased_estimate_that_bcrls_compensates() -> None:
    record = record_of(make_scenario("stop-and-go", seed=0, increments=512, duration=10.0))
    extended, compensated = (track_of(m, record, 3, 1.0)["mass"][-1] / CART.mass - 1 for m in (EXTENDED, "bcrls"))
    assert extended < -0.1
    assert abs(compensated) < 0.03


def test_a_recursive_method_is_not_off_line() -> None:
    with pytest.raises(TypeError, match="riv is not off-line"):
        mass_of("riv", record_of(make_scenario("prbs", duration=5.0)), 3)


# --- the figures ------------------------------------------------------------------------------------------------------


def test_figure_3_bias_grows_with_the_step_and_the_best_methods_have_none() -> None:
    coarse = figure3.work("1.44 kg", 512, 3)
    fine = figure3.work("1.44 kg", 4096, 3)
    assert coarse[EXTENDED].error < fine[EXTENDED].error < -0.05
    for method in ("iv", "auto"):
        assert abs(coarse[method].error) < 0.005
        assert abs(fine[method].error) < 0.005


def test_figure_4_follows_the_step() -> None:
    for method, (before, after) in figure4.work(1024, 5).items():
        assert abs(before.error) < 0.05, method
        assert abs(after.error) < 0.05, method
        assert 0.5 < after.settled < 4.0, method


def test_figure_5_designed_input_takes_half_the_time_of_the_pulses() -> None:
    pulses, best = (figure5.work(name, 0) for name in figure5.SHOWN)
    assert best["rls"].settled <= 0.5 * pulses["rls"].settled
    assert best["rls"].square < pulses["rls"].square
    assert best["rls"].settled > figure5.settle_time()


def test_figure_2_a_wrong_mass_misses_the_end() -> None:
    found = {label: figure2.work(label) for label in figure2.GUESSES}
    rows = figure2.rows({(label,): result for label, result in found.items()})
    nominal, large, small = rows
    assert nominal.loss == 0.0
    assert abs(nominal.terminal) < 0.1
    assert large.terminal > 1.0
    assert abs(small.terminal) > 2 * abs(nominal.terminal)


def test_every_input_does_the_same_errand() -> None:
    from pmfid.design.simulated import simulate

    for name, u in experiments().items():
        motion = simulate(problem(), u)
        assert motion.x[-1] == pytest.approx(STROKE, abs=1e-4), name
        assert abs(motion.v[-1]) < 1e-3, name
        assert np.abs(u).max() <= 3.0 + 1e-9, name
    assert set(pulse().tolist()) >= {0.0, 3.0}
    assert information(designed())[0] > 1.2 * information(experiments()["trapezoid"])[0]
    known, joint = information(designed())
    assert joint < known


@pytest.mark.parametrize(("name", "increments"), [("prbs", 256), ("stop-and-go", 256), ("stop-and-go", 64)])
def test_coarse_encoders(name: str, increments: int) -> None:
    scores = encoders.work(name, increments, 7)
    limits = {method: limit for scenario, method, among, limit in GOALS if scenario == name and increments in among}
    for method in set(limits) - {"bcrls"}:
        assert 100 * abs(scores[method].error) < limits[method], method
    assert ("auto" in scores) == (name != "prbs")


def test_not_the_encoder_but_stiction_biases_the_compensation() -> None:
    fine = encoders.without_encoder()
    assert fine["bcrls"] > 1.0
    assert abs(fine["iv"]) < 0.01


# --- pictures and data ------------------------------------------------------------------------------------------------


def small_drawing() -> Drawing:
    t = np.arange(50) / 10
    curves = {f"{n} inc": np.sin(t + n) for n in (1, 2, 3)}
    curves["1 inc"][:5] = np.nan
    return Drawing("small", t, ("nominal", np.zeros(50)), {"RLS": curves, "BCRLS": curves}, "mass [kg]", (-1.5, 1.5))


def test_picture_has_the_papers_colours_and_the_csv_what_is_drawn(tmp_path: Path) -> None:
    drawing = small_drawing()
    panels = draw(drawing).axes
    assert [axes.get_title(loc="left") for axes in panels] == ["RLS", "BCRLS"]
    for axes in panels:
        labels = {str(line.get_label()): line for line in axes.lines}
        colours = [to_hex(line.get_color()).upper() for line in labels.values()]
        assert colours == [*COLOURS[:3], MAGENTA]
        assert labels["nominal"].get_linestyle() == "--"
    assert {path.name for path in write_drawing(drawing, tmp_path)} == {"small.png", "small.csv"}
    with open(tmp_path / "small.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    drawn = np.asarray(panels[0].lines[1].get_ydata())
    assert [float(row["RLS: 2 inc"]) for row in rows] == pytest.approx(drawn.tolist(), rel=1e-8)
    assert [row["RLS: 1 inc"] for row in rows][:5] == [""] * 5


@pytest.mark.long
def test_same_seeds_same_files_whatever_the_processes(tmp_path: Path) -> None:
    folders = [tmp_path / "one", tmp_path / "two"]
    for jobs, folder in enumerate(folders, start=1):
        rows = reproduce(["4", "2"], folder, seeds=1, jobs=jobs)
    files = sorted(path.name for path in folders[0].iterdir())
    assert files == [
        *("figure2.csv", "figure2.png", "figure4-methods.csv", "figure4-methods.png", "figure4.csv", "figure4.png"),
        "table.csv",
    ]
    for name in files:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name
    assert {(row.figure, row.runs) for row in rows} == {("4", 1), ("2", 1)}


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_has_the_tasks_of_its_seeds(name: str) -> None:
    few, more = (FIGURES[name].tasks(seeds) for seeds in (1, 2))
    assert len(set(few)) == len(few)
    assert set(few) <= set(more)
    assert len(more) == (len(few) if name == "2" else 2 * len(few))


# --- the command and the page -----------------------------------------------------------------------------------------


def test_command_prints_the_table(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["2", "--out", str(tmp_path / "out"), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    assert "mass 20 % too large" in result.output
    assert (tmp_path / "out" / "table.csv").exists()
    assert max(map(len, result.output.splitlines()[:-1])) <= 80


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["6"], "unknown figure '6'; there are 2, 3, 4, 5, encoders"),
        (["encoder"], "unknown figure 'encoder'; did you mean 'encoders'?"),
        (["3", "--seeds", "0"], "seeds must be at least 1, got 0"),
        (["3", "--jobs", "0"], "jobs must be at least 1, got 0"),
    ],
)
def test_bad_usage_is_one_error(arguments: list[str], message: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert message in result.output
    assert not (tmp_path / "out").exists()


def test_wrong_numbers_are_refused_from_python_too(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="seeds must be at least 1"):
        reproduce((), tmp_path, seeds=0)


def test_sections_say_whether_a_goal_is_met() -> None:
    cases = {(scenario, method, n) for scenario, method, among, _ in GOALS for n in among}
    rows = [
        Merit("encoders", scenario, method, n, 200, bias=0.4 if method == "iv" else 2.0, std=0.1, coverage=90.0)
        for scenario, method, n in sorted(cases)
        if (scenario, n) != ("stop-and-go", 64)
    ]
    rows += [Merit("encoders", "stop-and-go", m, 64, 200, bias=0.9, std=0.1, coverage=95.0) for m in ("iv", "riv")]
    rows += [Merit("encoders", "stop-and-go", "auto", 64, 200, refused=200)]
    rows += [
        Merit("encoders", scenario, method, n, 200, bias=0.0, std=0.1, coverage=95.0)
        for scenario, among in (("prbs", (4096, 1024, 512, 256)), ("stop-and-go", (4096, 1024, 512, 256, 64)))
        for method in ("bcrls", "iv", "riv", "auto")
        for n in among
        if (scenario, method, n) not in cases
    ]
    text = "\n".join(sections(rows, "images"))
    assert "- prbs, 4096 to 256 increments, `iv`: +0.40 %, asked 0.5 %: met" in text
    assert "- stop-and-go, 4096 to 256 increments, `riv`: +2.00 %, asked 0.5 %: **not met**" in text
    assert "- stop-and-go, 64 increments, `iv`: +0.90 %, asked 1 %: met" in text
    assert re.search(r"stop-and-go, 64 increments, `auto`: \+nan %, asked 1 %: \*\*not met\*\*", text)


def test_python_example_of_the_page_runs() -> None:
    page = (ROOT / "docs" / "howto" / "laboratory.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(code, {})
