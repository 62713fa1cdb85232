"""Records of an uneven clock: true stamps, stamps of arrival, bursts, gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.pipeline.identify import identify, kind_of
from pmfid.pipeline.result import DriveResult
from pmfid.records.clock import slope_below
from pmfid.records.instants import find_instants
from pmfid.records.joining import make_even
from pmfid.records.record import Record, record_of
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.types import Counts, Floats
from tests.refusals import refused

#: Parts of a period in the simulation.
PARTS = 20
SAMPLES = 2500


def steps_of(clock: str, rng: np.random.Generator) -> Counts:
    """Return the steps (n,) of a clock in parts of a period."""
    if clock == "bursts":
        return np.where(np.arange(SAMPLES) % 4 == 3, 4 * PARTS - 15, 5)
    if clock == "in turn":
        return np.where(np.arange(SAMPLES) % 2 == 0, 18, 22)
    if clock == "host":
        return np.maximum(8, np.rint(PARTS * np.exp(0.25 * rng.standard_normal(SAMPLES)))).astype(int)
    return np.full(SAMPLES, PARTS)


def run(clock: str, delay: float = 0.0) -> tuple[Floats, Floats, Counts]:
    """Return stamps, input and counts of the cart; `delay` is the scale of the delay of the stamps [periods]."""
    rng = np.random.default_rng(7)
    steps = steps_of(clock, rng)
    at = np.r_[0, np.cumsum(steps)[:-1]]
    u = prbs(SAMPLES, clock=8, amplitude=2.0, rng=rng)
    x = simulate_drive(CART, np.repeat(u, steps), CART_DT / PARTS).x[at]
    late = np.sort(at * CART_DT / PARTS + delay * CART_DT * np.abs(rng.standard_normal(SAMPLES)))
    return late, u, quantize(x, 8 * CART_RESOLUTION)


def identified(
    folder: Path, time: Floats, u: Floats, counts: Counts, model: str = "", encoder: str = ""
) -> DriveResult:
    pl.DataFrame({"t": time, "u": u, "n": counts}).write_csv(folder / "run.csv")
    (folder / "axis.toml").write_text(
        '[record]\ninput = "u"\noutput = "n"\noutput_kind = "counts"\ntime = "t"\ntime_unit = "s"\n'
        f"[encoder]\nresolution = {8 * CART_RESOLUTION}\n{encoder}[model]\ninput_gain = {CART.input_gain}\n{model}"
    )
    axis = load_axis(folder / "axis.toml")
    found = identify(kind_of(axis).read([folder / "run.csv"], axis), axis)
    assert isinstance(found, DriveResult)
    return found


TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


@pytest.mark.parametrize("clock", ["bursts", "in turn", "host"])
def test_the_step_that_was_is_taken_where_stamps_are_true(tmp_path: Path, clock: str) -> None:
    result = identified(tmp_path, *run(clock))
    np.testing.assert_allclose(result.theta, TRUTH, rtol=3e-3)
    assert np.all(np.abs(result.theta - TRUTH) < 3.5 * result.theta_std)
    assert result.status == ()


@pytest.mark.parametrize(
    "clock", ["in turn", *(pytest.param(clock, marks=pytest.mark.long) for clock in ("bursts", "host"))]
)
def test_gaps_between_uneven_steps_stay_gaps(tmp_path: Path, clock: str) -> None:
    time, u, counts = run(clock)
    kept = np.ones(SAMPLES, bool)
    for first in np.random.default_rng(5).integers(100, SAMPLES - 100, 10):
        kept[first : first + 8] = False
    result = identified(tmp_path, time[kept], u[kept], counts[kept])
    np.testing.assert_allclose(result.theta, TRUTH, rtol=0.02)
    assert np.all(np.abs(result.theta - TRUTH) < 3.5 * result.theta_std)
    assert "uneven_clock" not in result.status


@pytest.mark.parametrize("key", ["exclude", "mask"])
def test_rows_of_an_uneven_clock_are_left_out(tmp_path: Path, key: str) -> None:
    """The left out rows have wrong counts at the start and within the record."""
    time, u, counts = run("in turn")
    bad = np.zeros(SAMPLES, bool)
    bad[:200] = bad[1200:1230] = True
    spans = [[float(time[0]), float(time[199])], [float(time[1200]), float(time[1229])]]
    pl.DataFrame({"t": time, "u": u, "n": np.where(bad, 7, counts), "bad": bad.astype(int)}).write_csv(
        tmp_path / "run.csv"
    )
    (tmp_path / "axis.toml").write_text(
        '[record]\ninput = "u"\noutput = "n"\noutput_kind = "counts"\ntime = "t"\n'
        f"{key} = {spans if key == 'exclude' else repr('bad')}\n"
        f"[encoder]\nresolution = {8 * CART_RESOLUTION}\n[model]\ninput_gain = {CART.input_gain}\n"
    )
    axis = load_axis(tmp_path / "axis.toml")
    record = kind_of(axis).read([tmp_path / "run.csv"], axis)
    assert record.steps is not None
    result = identify(record, axis)
    assert np.all(np.abs(result.theta - TRUTH) < 3.5 * result.theta_std)
    assert any("230 rows are left out" in note for note in result.notes)


@pytest.mark.parametrize("delay", [0.2, pytest.param(1.0, marks=pytest.mark.long), 3.0])
def test_stamps_of_arrival_give_what_even_stamps_give(tmp_path: Path, delay: float) -> None:
    method = '[estimator]\nmethod = "iv"\n'
    even, late = (identified(tmp_path, *run("even", by), method) for by in (0.0, delay))
    np.testing.assert_allclose(late.theta, even.theta, rtol=2e-3)
    assert "uneven_clock" not in late.status


def test_the_intervals_contain_the_error_of_the_period(tmp_path: Path) -> None:
    late, even = identified(tmp_path, *run("even", 3.0)), identified(tmp_path, *run("even"))
    assert 0 < late.record.dt_error < 1e-3
    assert even.record.dt_error == 0
    added = np.sqrt(late.theta_std**2 - late.fit.theta_std**2)
    assert np.all(added[:2] >= 0.99 * np.array([2, 1]) * late.record.dt_error * late.theta[:2])
    assert any("the intervals contain" in finding.sentence for finding in late.findings)


def test_a_clock_that_drifts_is_flagged(tmp_path: Path) -> None:
    time, u, counts = run("even")
    assert "uneven_clock" in identified(tmp_path, time + time**2 / 200, u, counts).status


@pytest.mark.parametrize(
    ("method", "more"), [("iv", "dead_time = 0.01\n"), ("riv", "dead_time = 0.01\n"), ("riv", "prior")]
)
def test_no_estimate_comes_from_resampled_samples(tmp_path: Path, method: str, more: str) -> None:
    """The record was once resampled, and no standard error contained the error of resampling."""
    prior = "[estimator.prior]\nmass = [1.0, 0.5]\n"
    end = (
        f'[estimator]\nmethod = "{method}"\n{prior}' if more == "prior" else f'{more}[estimator]\nmethod = "{method}"\n'
    )
    refused(('method = "auto"', lambda: identified(tmp_path, *run("host"), end)))
    end = prior if more == "prior" else more
    found = identified(tmp_path, *run("host"), end)
    assert "uneven_clock" not in found.status


def test_even_samples_lose_no_impulse_and_a_gap_stays_a_gap() -> None:
    rng = np.random.default_rng(2)
    steps = rng.uniform(0.5, 1.5, 400)
    steps[200] = 20.0
    time, u = np.r_[0.0, np.cumsum(steps)], rng.standard_normal(401)
    found = find_instants(time, u, np.sin(0.05 * time))
    assert found is not None
    assert np.count_nonzero(~found.there) == np.count_nonzero(np.isnan(found.u)) == pytest.approx(20, abs=1)
    before = SampleSteps(np.append(found.period, np.diff(found.time)))
    record = Record(found.u, np.rint(1e4 * found.y).astype(np.int64), found.period, 1e-4, (), "run", steps=before)
    even = make_even(record)
    assert np.count_nonzero(np.isnan(even.u)) == pytest.approx(20, abs=1)
    rows = int((time[200] - 2) / even.dt)
    whole = np.interp(rows * even.dt, time, np.r_[0.0, np.cumsum(u[:-1] * steps)])
    assert np.sum(even.u[:rows]) * even.dt == pytest.approx(whole)
    seen = np.isfinite(even.u)
    np.testing.assert_allclose(1e-4 * even.counts[seen], np.sin(0.05 * even.times[seen]), atol=2e-3)


@pytest.mark.parametrize("far", [1e6, 1e15])
def test_a_stamp_that_is_far_off_fills_no_memory(far: float) -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 400))
    time[200:] += far
    found = find_instants(time, np.ones(400), np.sin(0.05 * np.arange(400)))
    assert found is not None
    assert found.time.size < 2000


@pytest.mark.parametrize(("late", "spread"), [(0.0, 0.09), (0.0, 0.5), (0.3, 0.0), (2.0, 0.0)])
def test_a_coarse_encoder_tells_instants_from_arrivals(late: float, spread: float) -> None:
    """Steps of one count suffice to find a jitter, or an even clock with late stamps."""
    rng = np.random.default_rng(5)
    time = np.arange(3000) + spread * rng.uniform(-1, 1, 3000)
    counts = np.floor(60 * np.sin(0.05 * time) + 0.3)
    stamps = np.sort(time + late * np.abs(rng.standard_normal(3000)))
    found = find_instants(stamps, np.ones(3000), counts)
    assert (found is not None and not found.even) == (late == 0)


def test_many_small_gaps_of_an_uneven_clock_restart_the_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    steps = rng.integers(16, 25, SAMPLES)
    at = np.r_[0, np.cumsum(steps)[:-1]]
    u = 2.5 * np.sin(0.07 * np.arange(SAMPLES)) + 1.5 * np.sin(0.19 * np.arange(SAMPLES))
    x = simulate_drive(CART, np.repeat(u, steps), CART_DT / PARTS).x[at]
    kept = np.ones(SAMPLES, bool)
    for first in range(20, SAMPLES - 20, 30):
        kept[first : first + int(rng.integers(2, 5))] = False
    result = identified(tmp_path, (at * CART_DT / PARTS)[kept], u[kept], quantize(x, 8 * CART_RESOLUTION)[kept])
    np.testing.assert_allclose(result.theta[:2], TRUTH[:2], rtol=0.01)  # a step may hide lost rows
    assert "unmodelled" in result.status


def test_a_counter_wraps_on_an_uneven_clock(tmp_path: Path) -> None:
    time, u, counts = run("host")
    result = identified(tmp_path, time, u, counts % 2**12, encoder="bits = 12\n")
    np.testing.assert_array_equal(result.theta, identified(tmp_path, time, u, counts).theta)
    assert any("counter wrapped" in finding.sentence for finding in result.findings)


@pytest.mark.parametrize(("delay", "part"), [(0.2, 0.2), (1.0, 0.3)])
def test_the_period_of_late_stamps_is_that_of_the_line_below_them(delay: float, part: float) -> None:
    """A delay never makes a stamp early; errors in both directions keep the line through the stamps."""
    rng, n = np.random.default_rng(7), 3000
    through, below, both = [], [], []
    for _ in range(20):
        late = np.sort(np.arange(n) + delay * np.abs(rng.standard_normal(n))) - np.arange(n)
        slope, start = np.polyfit(np.arange(n), late, 1)
        through.append(slope)
        below.append(slope + slope_below(late - start - slope * np.arange(n)))
        both.append(slope_below(delay * rng.standard_normal(n)))
    assert np.linalg.norm(below) < part * np.linalg.norm(through)
    assert not np.any(both)


def test_samples_that_arrive_at_once_are_samples_of_an_even_clock() -> None:
    rng, n = np.random.default_rng(8), 1500
    k = np.arange(n)
    u, y = rng.standard_normal(n), 100 * np.sin(0.2 * k + np.sin(0.01 * k))
    stamps = np.sort(k + 2 * np.abs(rng.standard_normal(n)))
    stamps[[401, 402, 900]] = stamps[[400, 400, 899]]
    found = find_instants(stamps, u, y)
    assert found is not None
    assert not found.jitter
    np.testing.assert_array_equal(found.u, u)
    assert np.diff(found.time).mean() == pytest.approx(1.0, rel=1e-3)
    y[401], u[401] = y[400], u[400]  # a row that was written twice
    twice = find_instants(stamps, u, y)
    assert twice is not None
    assert twice.u.size == n - 1


def test_a_scattered_stamp_soon_after_another_is_no_row_too_many() -> None:
    rng, n = np.random.default_rng(9), 1500
    stamps = np.arange(n) + 0.1 * np.abs(rng.standard_normal(n))
    stamps[700:702] = 700.75, 701.0
    columns = {"t": 0.01 * stamps, "u": rng.standard_normal(n), "n": np.arange(n) // 400}
    record = {"input": "u", "output": "n", "output_kind": "counts", "time": "t"}
    axis = Axis.model_validate({"record": record, "encoder": {"resolution": 1e-3}, "model": {"input_gain": 1.0}})
    found = record_of(columns, axis)
    assert np.count_nonzero(np.isfinite(found.u)) == n
    assert found.dt == pytest.approx(0.01, rel=1e-5)
