"""Records of an uneven clock: true stamps, stamps of arrival, bursts, gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.config.axis import load_axis
from pmfid.pipeline.identify import identify, kind_of
from pmfid.pipeline.result import DriveResult
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.types import Counts, Floats
from tests.conftest import TRUTH, long_unless
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


@pytest.mark.parametrize("clock", long_unless("host".__eq__, ["bursts", "in turn", "host"]))
def test_the_step_that_was_is_taken_where_stamps_are_true(tmp_path: Path, clock: str) -> None:
    result = identified(tmp_path, *run(clock))
    np.testing.assert_allclose(result.theta, TRUTH, rtol=3e-3)
    assert np.all(np.abs(result.theta - TRUTH) < 3.5 * result.theta_std)
    assert result.status == ()


@pytest.mark.parametrize("clock", long_unless("host".__eq__, ["bursts", "in turn", "host"]))
def test_gaps_between_uneven_steps_stay_gaps(tmp_path: Path, clock: str) -> None:
    time, u, counts = run(clock)
    kept = np.ones(SAMPLES, bool)
    for first in np.random.default_rng(5).integers(100, SAMPLES - 100, 10):
        kept[first : first + 8] = False
    result = identified(tmp_path, time[kept], u[kept], counts[kept])
    np.testing.assert_allclose(result.theta, TRUTH, rtol=2e-3)
    assert np.all(np.abs(result.theta - TRUTH) < 3.5 * result.theta_std)
    assert "uneven_clock" not in result.status


@pytest.mark.parametrize("delay", long_unless((3.0).__eq__, [0.2, 1.0, 3.0]))
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
