"""The referee: its integrator against closed forms and a halved step, its machines, and its table."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.referee import judge as judging
from studies.referee import machines
from studies.referee.__main__ import main
from studies.referee.cases import FAST, FAST_SUBSTEPS, PARAMETERS, SUBSTEPS, Case, excite, make_cases
from studies.referee.judge import Answer, Row, judge
from studies.referee.machines import KINDS, draw_machine
from studies.referee.table import compare, summarise
from tests.oracles.axis import Axes, Excitation, Motion, simulate_axes


@pytest.fixture(autouse=True)
def shorten_records(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "SAMPLES", (200, 300))


Floats = np.ndarray[Any, np.dtype[np.float64]]


def drive(axes: Axes, feed: Floats, substeps: int = 10) -> Motion:
    """Simulate one axis under a given input."""
    zeros, ones, none = np.zeros((feed.size, 1)), np.ones((feed.size, 1)), np.zeros(1)
    window, top = np.ones(1, np.intp), np.full(1, np.inf)
    excitation = Excitation(feed[:, None], ones, zeros, none, none, window, top, zeros, ones)
    return simulate_axes(axes, excitation, none, substeps)


def test_the_integrator_stops_inside_a_sample_as_the_closed_form_does() -> None:
    m, d, f = 5.0, 0.5, 0.3
    motion = drive(Axes(m, d, f), np.r_[np.ones(20), np.zeros(20)])
    v0 = (1 - f) / d * (1 - np.exp(-20 * d / m))
    stop = m / d * np.log(1 + v0 * d / f)
    t = np.minimum(np.arange(20), stop)
    x = m / d * (v0 + f / d) * (1 - np.exp(-t * d / m)) - f / d * t
    assert 3 < stop < 19
    np.testing.assert_allclose(motion.x[20:, 0] - motion.x[20, 0], x, rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion.v[20, 0], v0, rtol=1e-7)
    assert motion.v[-1, 0] == 0.0


def test_two_masses_keep_momentum_and_resonance() -> None:
    axes = Axes(1.0, 0.0, 0.0, second_mass=np.ones(1), stiffness=0.5)  # resonance sqrt(0.5 * 2) = 1 rad/sample
    x = drive(axes, np.r_[1.0, np.zeros(300)], substeps=20).x[1:, 0]
    k = np.arange(x.size)
    basis = np.column_stack([np.ones(k.size), k, np.cos(k), np.sin(k)])
    weights = np.linalg.lstsq(basis, x, rcond=None)[0]
    assert weights[1] == pytest.approx(0.5, rel=1e-6)
    assert np.max(np.abs(x - basis @ weights)) < 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_half_the_step_gives_the_same_motion(kind: str) -> None:
    axes = [draw_machine(3, kind, index) for index in range(7)]
    names = {name for machine in axes for name in machine.effect} - {"push", "friction"}
    values = {name: np.array([getattr(machine.pace, name) for machine in axes]) for name in PARAMETERS}
    values |= {name: np.array([machine.effect[name] for machine in axes]) for name in names}
    whole = excite(axes)
    short = {f.name: getattr(whole, f.name)[:80] for f in fields(whole) if getattr(whole, f.name).ndim == 2}
    substeps = FAST_SUBSTEPS if kind in FAST else SUBSTEPS
    start = np.array([machine.zero for machine in axes])
    coarse, fine = (simulate_axes(Axes(**values), replace(whole, **short), start, n) for n in (substeps, 2 * substeps))
    bound = 1e-2 if kind == "backlash" else 1e-5  # every impact amplifies a difference
    assert np.all(np.max(np.abs(coarse.x - fine.x), axis=0) <= bound * np.max(np.abs(fine.x), axis=0))


def test_a_machine_does_not_depend_on_the_others_of_its_batch() -> None:
    (alone,), (_, _, third) = make_cases(5, "load", [2]), make_cases(5, "load", [0, 1, 2])
    np.testing.assert_array_equal(alone.u, third.u)
    np.testing.assert_array_equal(alone.counts, third.counts)
    assert alone.truth == third.truth


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_a_bent_input_leaves_the_gain_open(gain: float, monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_cases(5, "bending", [0])[0]
    bent, largest = draw_machine(5, "bending", 0), np.max(np.abs(case.u))
    assert np.unique(np.abs(case.u)).size == 1  # two levels
    assert case.seen_gain == pytest.approx(1 - bent.effect["bending"] * largest / bent.scale.top)
    case = replace(case, seen_gain=0.9)
    theta = {name: value / gain for name, value in case.truth.items()}
    monkeypatch.setattr(judging, "load_call", lambda _: lambda _: Answer(theta, theta, {}, (), ""))
    assert [judge("", case)[f"{name}_error"] for name in PARAMETERS] == pytest.approx([0.0] * 3)


def test_the_table_counts_silent_errors_coverage_and_length(monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_cases(5, "right", [0])[0]

    def make_row(error: float, std: float, *status: str) -> Row:
        theta = {name: value * (1 + error) for name, value in case.truth.items()}
        stds = {name: std * value for name, value in case.truth.items()}
        interval = {name: (theta[name] - 1.96 * stds[name], theta[name] + 1.96 * stds[name]) for name in theta}
        monkeypatch.setattr(judging, "load_call", lambda _: lambda _: Answer(theta, stds, interval, status, ""))
        return judge("", case)

    rows = [make_row(0.001, 0.002), make_row(-0.002, 0.002), make_row(0.05, 0.002), make_row(0.05, 0.002, "unmodelled")]
    line = summarise("right", rows)
    assert (line["runs"], line["empty"], line["wrong"], line["silent"]) == (4, 3, 2, 1)
    assert line["mass_covered"] == 50.0
    assert line["mass_most"] == pytest.approx(5.0)
    assert line["mass_length"] == pytest.approx(0.002 / np.sqrt((1 + 4 + 2 * 2500) / 4 * 1e-6))


def test_a_larger_error_than_before_is_listed() -> None:
    before = {"kind": "load"} | {f"{name}_{what}": 1.0 for name in PARAMETERS for what in ("median", "most")}
    assert compare([before], [before]) == []
    assert compare([before | {"mass_most": 1.2}], [before]) == ["load: mass most 1.2 %, before 1 %"]


def endless(case: Case) -> Answer:
    while True:
        pass


def refusing(case: Case) -> Answer:
    raise ValueError("no motion")


def test_errors_and_endless_fits_are_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judging, "MOST_SECONDS", 0.05)
    case = make_cases(5, "right", [0])[0]
    rows = [judge(f"{__name__}:{name}", case) for name in ("endless", "refusing")]
    assert [row["refused"] for row in rows] == ["OutOfTime: 0.05 s", "ValueError: no motion"]
    assert summarise("right", rows)["refusals"] == "1 OutOfTime, 1 ValueError"


def test_an_interrupted_run_continues_with_the_missing_machines(tmp_path: Path) -> None:
    out = tmp_path / "table.md"
    common = ["--kinds", "right", "--seed", "5", "--jobs", "1", "--call", f"{__name__}:refusing", "--out", str(out)]
    assert main([*common, "--right", "1"]) == 0
    first = (tmp_path / "table_rows.csv").read_text(encoding="utf-8").splitlines()
    assert main([*common, "--right", "2", "--resume"]) == 0
    both = (tmp_path / "table_rows.csv").read_text(encoding="utf-8").splitlines()
    assert both[:2] == first
    assert len(both) == 3
    assert "right,2,2,2 ValueError" in out.with_suffix(".csv").read_text(encoding="utf-8")
    assert "| right | 2 | 2 | 0 |" in out.read_text(encoding="utf-8")
