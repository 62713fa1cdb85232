"""Faults that generated calls found, each tested at its cause: `python -m tests.hostile.study`."""

from __future__ import annotations

import math
import re
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.config.record import RecordConfig
from pmfid.design.appraisal import _stds
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import RLS
from pmfid.kernel.saved import configuration
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import calibrate, simulated_counts
from pmfid.pipeline.designs import load_spec, make_problem
from pmfid.pipeline.monitored.lines import LineParser
from pmfid.records.clock import sample_period
from pmfid.report.monitored import RunData, _velocity, run_figure
from pmfid.status import Status
from tests.command import run_command
from tests.refusals import refused
from tests.test_front import CART
from tests.test_states import forged, used

THETA = np.array([1.07, 12.8, 0.8])
NAMES = ("mass", "viscous_friction", "coulomb_friction")


def riv() -> RIV:
    return RIV(Drive(2.0), Encoder(2e-4), 0.01, 30.0, forgetting=0.995, initial=dict(zip(NAMES, THETA, strict=True)))


# --- a monitor's reference --------------------------------------------------------------------------------------------


def test_a_reference_that_shows_no_scatter_is_refused() -> None:
    """And normal parameters of a machine that runs away."""
    u = np.where(np.arange(120) // 20 % 2, 3.0, -3.0)
    counts, away = simulated_counts(riv(), THETA, u, 0.5), np.array([1.0, -200.0, 0.1])
    short = r"has 1\.2 s, too few to measure its scatter, .* record longer, 10 minutes or more"
    refused((short, lambda: calibrate(riv(), THETA, u, counts, hours=0.5)))
    unstable = "is unstable under the recorded input"
    refused((unstable, lambda: simulated_counts(riv(), away, np.ones(2000), 0.5)), kind=NotIdentifiableError)


# --- a pipe -----------------------------------------------------------------------------------------------------------


def parser(tmp_path: Path, header: bytes) -> LineParser:
    (tmp_path / "axis.toml").write_text(CART.replace("[record]", '[record]\ntime = "t"'))
    return LineParser(header, load_axis(tmp_path / "axis.toml"))


def test_two_columns_of_one_name_are_refused_in_a_pipe(tmp_path: Path) -> None:
    refused(("standard input has two columns 'u'; rename one of them", lambda: parser(tmp_path, b"t,u,counts, u\n")))


# --- a record ---------------------------------------------------------------------------------------------------------


def test_a_logger_that_started_again_is_cut_there() -> None:
    time = np.r_[np.arange(300), np.arange(200)] * 0.01
    config = RecordConfig(input="u", output="y", time="t")
    with pytest.raises(UsageError, match="keep the rows up to 300 or from 301 on") as caught:
        sample_period(time, config)
    assert "row 301" in str(caught.value)
    for part in (time[:300], time[300:]):
        assert sample_period(part, config)[0] == pytest.approx(0.01)


# --- memory -----------------------------------------------------------------------------------------------------------


def slow() -> RLS:
    return RLS(Drive(2.0), Encoder(2e-4), 1e-5, 0.5, forgetting=1.0)


def test_a_low_cutoff_takes_no_memory() -> None:
    """Responses of millions of samples once took gigabytes for any record."""
    tracemalloc.start()
    try:
        slow().make_kernel()
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()


# --- a design ---------------------------------------------------------------------------------------------------------


def test_a_design_from_rest_for_the_worst_case_ends_in_numbers(tmp_path: Path) -> None:
    """Standard inputs without information once gave a gain of inf."""
    lines = ["[drive]", "input_gain = 2.0", "mass = 1.5", "viscous_friction = 6.0", "coulomb_friction = 0.6"]
    lines += ["[encoder]", "resolution = 1e-5", "[experiment]", 'unknown = ["mass", "viscous_friction"]']
    lines += ['criterion = "E"', "[motion]", "duration = 1.0", "intervals = 3", "[limits]", "input = 3.0"]
    lines += ["[robust]", "mass = 0.1", 'average = "worst"', "[search]", "starts = 1"]
    (tmp_path / "spec.toml").write_text("\n".join(lines))
    result = run_command("design", str(tmp_path / "spec.toml"), "--certify", "0")
    assert re.search(r"\b(inf|nan)\b", result.stdout) is None
    problem = make_problem(load_spec(tmp_path / "spec.toml"))
    assert _stds(problem, np.zeros((2, 2))) == {"mass": math.inf, "viscous_friction": math.inf}


def test_more_than_anybody_waits_for_is_refused(tmp_path: Path) -> None:
    (tmp_path / "spec.toml").write_text(Path(__file__).parents[1].joinpath("examples", "cart_design.toml").read_text())
    spec = partial(load_spec, tmp_path / "spec.toml")
    refused(
        (r"\[search\] starts = ", lambda: spec({"search.starts": 10**400})),
        (r"\[search\] seed = ", lambda: spec({"search.seed": 2**63})),
        (r"\[motion\] duration = ", lambda: spec({"motion.duration": 1e30})),
        (r"\[limits\]: input = 1e\+308 limits nothing; leave the limit out", lambda: spec({"limits.input": 1e308})),
    )


# --- the kernel -------------------------------------------------------------------------------------------------------


def test_a_foreign_state_has_no_negative_variance() -> None:
    """A foreign state may be no sum of squares: the variance once became negative."""
    estimator = used("rls", "float32")
    parameters = int(configuration(estimator.kernel, "float32")["direct"]["n_parameters"])
    for element in range(1, parameters * parameters):
        estimator.set_state(forged(estimator, "direct.sums.cross", 1e9, element))
        track = estimator.run(np.tile([3.0, -3.0], 30), np.arange(60))
        assert np.all(track.variance_factor >= 0)


# --- a page -----------------------------------------------------------------------------------------------------------


def test_the_range_of_the_velocity_is_that_of_accepted_samples() -> None:
    n, t = 200, 0.01 * np.arange(200)
    counts, status = np.sin(10 * t), np.zeros(n, np.uint32)
    counts[90:] += 1e6
    status[90] = Status.COUNT_JUMP
    theta = np.tile(THETA, (n, 1))
    words = np.full(n, "watching")
    data = RunData(NAMES, ("kg", "N s/m", "N"), t, t, _velocity(counts, t), theta, theta, t, status, words, THETA, [])
    panels = {axes.get_ylabel(): axes for axes in run_figure(data).axes}
    (low, high) = next(axes.get_ylim() for name, axes in panels.items() if "velocity" in name)
    assert -12 < low < -9
    assert 9 < high < 12
