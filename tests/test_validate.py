"""`pmfid validate` and `pmfid.validate`: free runs over other records, and invalid results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.config.axis import load_axis
from pmfid.diagnostics.free_run import drive_run
from pmfid.estimators.motion_fit import MotionFit
from pmfid.simulation import DriveParameters, prbs, quantize, simulate_drive
from pmfid.simulation.process import simulate_process
from studies.record_parts import measured
from tests.command import counted_axis, run_command
from tests.conftest import Run, needs_emps

pytestmark = pytest.mark.usefixtures("without_judgement")

#: An axis that only this file uses.
AXIS = DriveParameters(mass=0.45, viscous_friction=3.1, coulomb_friction=0.6, input_gain=1.5)
DT, STEP = 0.005, 5e-5
TOML = counted_axis(0.005, 5e-5, 1.5) + "[estimator]\ncutoff = 60.0\n"
GOOD = {
    "model": "drive",
    "method": "iv",
    "input_gain": 1.5,
    "parameters": {
        "mass": {"value": 0.45, "std": 0.01, "unit": "kg"},
        "viscous_friction": {"value": 3.1, "std": 0.01, "unit": "N s/m"},
        "coulomb_friction": {"value": 0.6, "std": None, "unit": "N"},
    },
}


def run_of(seed: int, samples: int = 1200, v0: float = 0.0) -> Run:
    rng = np.random.default_rng([seed, 77])
    u = prbs(samples, clock=14, amplitude=3.0, rng=rng)
    x = simulate_drive(AXIS, u, DT, v0=v0).x
    return Run(u, quantize(x, STEP, STEP * rng.random()), pmfid.Encoder(STEP))


def files(folder: Path, content: object = GOOD, toml: str = TOML, seeds: tuple[int, ...] = (1,)) -> list[str]:
    """Write a record for each seed and return the arguments of the command; `content` is RESULT.json as text or
    object.
    """
    folder.mkdir(exist_ok=True)
    records = []
    for seed in seeds:
        run = run_of(seed)
        records.append(str(folder / f"run{seed}.csv"))
        np.savetxt(records[-1], np.column_stack([run.u, run.counts]), "%.17g", ",", header="u,counts", comments="")
    (folder / "axis.toml").write_text(toml)
    text = content if isinstance(content, str) else json.dumps(content)
    (folder / "result.json").write_text(text, encoding="utf-8")
    options = ["--config", str(folder / "axis.toml"), "--model", str(folder / "result.json")]
    return ["validate", *records, *options]


def test_the_truth_predicts_every_count_of_every_record(tmp_path: Path) -> None:
    result = run_command(*files(tmp_path, seeds=(1, 2)), "--json")
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert [record["record"] for record in found["records"]] == ["run1.csv", "run2.csv"]
    for record in found["records"]:
        assert record["rmse"] < 1.5 * record["encoder"] < 1e-4
        assert record["fit"] > 99.9
        assert [horizon["seconds"] for horizon in record["horizons"]] == [1.0, 2.0, 5.0]
        assert all(horizon["rmse"] < 0.01 * horizon["standstill"] for horizon in record["horizons"])
    assert any("explains every count" in note for note in found["notes"])


def test_what_identify_writes_is_what_validate_reads(tmp_path: Path) -> None:
    arguments = files(tmp_path, seeds=(1, 2))
    one, config = arguments[1], arguments[4]
    run_command("identify", one, "--config", config, "--out", tmp_path / "id", "--method", "ls")
    arguments[-1] = str(tmp_path / "id" / "result.json")
    result = run_command(*arguments, "--out", tmp_path / "out")
    assert result.stderr == ""
    assert "Parameters by ls" in result.stdout
    assert "run2.csv" in result.stdout
    page = (tmp_path / "out" / "validation.html").read_text("utf-8")
    assert page.count("<figure") == 3
    stored = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert stored == json.loads(run_command(*arguments, "--json").stdout)


def test_python_gives_what_the_command_gives(tmp_path: Path) -> None:
    train, other = run_of(3), run_of(1)
    result = pmfid.identify(
        train.u, train.counts, model=pmfid.Drive(1.5), encoder=train.encoder, dt=DT, cutoff=60.0, method="iv"
    )
    found = pmfid.validate(result, other.u, other.counts).to_dict()
    printed = json.loads(run_command(*files(tmp_path, result.to_dict()), "--json").stdout)
    assert found["records"][0] | {"record": "run1.csv"} == printed["records"][0]
    assert found["parameters"] == printed["parameters"]
    finer = pmfid.validate(result, other.u, other.counts * 10, encoder=pmfid.Encoder(STEP / 10), dt=DT)
    assert finer.runs[0].rmse == pytest.approx(found["records"][0]["rmse"], rel=0.5)


def method(step: float = STEP) -> MotionFit:
    return MotionFit(pmfid.Drive(1.5), pmfid.Encoder(step), DT, 60.0)


def test_each_part_between_gaps_has_a_start_and_missing_counts_have_no_error() -> None:
    run, there = run_of(2), np.arange(1200) % 7 > 0
    u, counts = run.u.copy(), run.counts.copy()
    u[500:520], counts[500:520], counts[~there] = np.nan, counts[500], counts[0]
    found = drive_run(method(), np.array([0.45, 3.1, 0.6]), u, counts, "gap", there)
    assert found.t.size == np.count_nonzero(there) - np.count_nonzero(there[500:520])
    assert found.encoder is not None
    assert found.rmse < 1.2 * found.encoder


def process_record(seed: int, samples: int = 600, slower: float = 1.0) -> pmfid.Experiment:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], samples // 6).repeat(6)
    y = simulate_process(np.array([3.0]), np.array([1.0, 1.1, 2.0]), u, 0.1)
    noisy = 5.0 + y + 0.02 * rng.standard_normal(samples)
    return pmfid.Experiment(u, noisy, dt=0.1 * slower, name=f"p{seed}")


def test_a_transfer_function_predicts_other_records_gaps_included(tmp_path: Path) -> None:
    model = pmfid.TransferFunction(2, 0, offset=True)
    result = pmfid.identify(process_record(1), model=model, cutoff=2.0)
    other = process_record(2)
    t = np.arange(600) * 0.1 + 30.0 * (np.arange(600) > 250)
    y = other.y.copy()
    y[100:120] = np.nan
    with_gap = pmfid.Experiment(other.u, y, t=t, name="gap")
    found = pmfid.validate(result, [other, with_gap])
    assert [run.name for run in found.runs] == ["p2", "gap"]
    assert [run.t.size for run in found.runs] == [600, 580]
    for run in found.runs:
        assert run.rmse == pytest.approx(0.02, rel=0.35)
        assert run.fit is not None
        assert run.fit > 95
        assert run.encoder is None
        assert run.horizons
    found.to_dict()


def changed(**parts: object) -> dict[str, object]:
    return {**GOOD, **parts}


def parameter(**parts: object) -> dict[str, object]:
    """Return the result with another mass."""
    return changed(parameters=GOOD["parameters"] | {"mass": {"value": 0.45, "unit": "kg", **parts}})


HOSTILE: dict[str, tuple[object, str]] = {
    "empty": ("", "not a result in JSON"),
    "not JSON": ("mass = 3", "not a result in JSON"),
    "no object": ([1, 2], "the file: it should be"),
    "a number": ("3", "the file"),
    "deep": ("[" * 100_000, "not a result in JSON"),
    "NaN": (json.dumps(parameter(value=float("nan"))), "NaN is not a number"),
    "infinite": (json.dumps(parameter(value=float("inf"))), "Infinity is not a number"),
    "overflow": (json.dumps(parameter(value=1)).replace('"value": 1,', '"value": 1e999,'), "finite"),
    "huge": (json.dumps(parameter(value=1)).replace('"value": 1,', f'"value": 1{"0" * 400},'), "result.json"),
    "text for a number": (parameter(value="0.45"), "parameters.mass.value: it should be a valid number"),
    "truth for a number": (parameter(value=True), "parameters.mass.value"),
    "no model": ({"parameters": GOOD["parameters"]}, "model is missing"),
    "no parameters": ({"model": "drive"}, "parameters is missing"),
    "none of them": (changed(parameters={}), "at least 1"),
    "a list of them": (changed(parameters=[1]), "parameters: it should be a valid dict"),
    "no value": (changed(parameters={"mass": {}}), "parameters.mass.value is missing"),
    "wrong kind": (changed(model="transfer_function"), 'kind = "transfer_function"'),
    "one lacks": (changed(parameters={"mass": {"value": 1.0}}), "has no viscous_friction, coulomb_friction"),
    "one too many": (changed(parameters=GOOD["parameters"] | {"offset": {"value": 1.0}}), "has offset"),
    "other unit": (parameter(unit="g"), "mass is in 'g' in the result, but in 'kg'"),
    "other gain": (changed(input_gain=3.0), "input_gain = 3, but [model] has 1.5"),
    "no text": (changed(equation=3), "equation: it should be a valid string"),
    "a page for an equation": (changed(equation="\x1b[31m x \n" * 9999), "but [model] has mass x''"),
    "no mass": (parameter(value=0.0), "mass = 0"),
    "negative mass": (parameter(value=-1.0), "mass = -1"),
    "the error of compare": ({"record": "x", "methods": {}}, "model is missing"),
}


@pytest.mark.parametrize(("content", "said"), HOSTILE.values(), ids=list(HOSTILE))
def test_what_is_no_result_is_reported_in_one_line(tmp_path: Path, content: object, said: str) -> None:
    result = run_command(*files(tmp_path, content), code=2)
    assert result.stdout == ""
    assert result.stderr.startswith("pmfid: ")
    assert result.stderr.count("\n") == 1
    assert len(result.stderr) < 600
    assert said in result.stderr
    assert ";" in result.stderr


@pytest.mark.parametrize(
    ("then", "now"), [("dead_time = 0.004", ""), ("", "dead_time = 0.004"), ("stribeck = 0.02", "stribeck = 0.03")]
)
def test_what_no_name_of_a_parameter_tells_must_be_the_same(tmp_path: Path, then: str, now: str) -> None:
    """A silent change of the dead time would predict a machine with a late input without the delay."""
    before, after = (TOML.replace("input_gain = 1.5", f"input_gain = 1.5\n{key}") for key in (then, now))
    more = GOOD["parameters"] | ({"stribeck_friction": {"value": 0.1, "unit": "N"}} if "stribeck" in then else {})
    (tmp_path / "then.toml").write_text(before)
    found = changed(parameters=more, equation=load_axis(tmp_path / "then.toml").model.make().equation.text)
    run_command(*files(tmp_path / "same", found, before))
    result = run_command(*files(tmp_path / "other", found, after), code=2)
    assert result.stderr.count("\n") == 1
    assert "but [model] has" in result.stderr


#: Least squares of the authors on the whole record (Janot, Gautier and Brunot 2019).
PUBLISHED = {
    "symmetric, offset": (pmfid.Drive(1.0, offset=True), np.array([95.1089, 203.5034, 20.3935, -3.1648])),
    "directional": (pmfid.Drive(1.0, friction="directional"), np.array([95.154, 166.7061, 240.4236, 20.144, 20.6277])),
}


@needs_emps
def test_the_published_parameters_predict_the_measured_drive() -> None:
    """The record is the last third, as in the authors' paper. Directional friction predicts better, as the
    authors say.
    """
    whole = measured(5e-8)
    last = slice(whole.u.size * 2 // 3, None)
    encoder, runs = pmfid.Encoder(whole.resolution), {}
    for name, (model, theta) in PUBLISHED.items():
        runs[name] = drive_run(
            MotionFit(model, encoder, whole.dt, 50.0), theta, whole.u[last], whole.counts[last], name
        )
    assert runs["symmetric, offset"].rmse == pytest.approx(7.3e-3, rel=0.05)
    assert runs["directional"].rmse == pytest.approx(3.5e-3, rel=0.05)
    assert [horizon.seconds for horizon in runs["directional"].horizons] == [1.0, 2.0, 5.0]
