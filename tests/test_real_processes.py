"""Transfer functions of real records: integrators, m = n, dead times of any length, unstable poles under control."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pmfid import BCLS, IV, LS, SRIVC, Encoder, Experiment, TransferFunction
from pmfid.estimators.registry import methods_for
from pmfid.linear.experiment import Grid, respond
from pmfid.linear.process import Process
from pmfid.linear.responses import respond_bounded
from pmfid.simulation.process import simulate_process
from studies.late_processes import Controller, simulate_late, simulate_loop
from studies.real_processes import work
from tests.command import run_command
from tests.refusals import refused

DT = 0.05
ONE = Encoder(1.0)


def steps(seed: int, size: int = 600, hold: str = "zoh") -> np.ndarray:
    u = np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], size // 4), 4)
    return np.convolve(u, np.ones(3) / 3, "same") if hold == "foh" else u


def fitted(model: TransferFunction, record: Experiment) -> np.ndarray:
    return SRIVC(model, ONE, DT, 2.0).fit_experiments([record]).theta


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize(
    ("b", "a", "integrators"),
    [
        ([3.0], [1, 1, 0], 1),
        ([3.0], [1, 0, 0], 2),
        ([1.0, 3.0], [1, 2, 0, 0], 2),
        ([1.0, 3.0], [1, 0], 1),
        ([1.0, 3.0], [1, 2], 0),
        ([0.5, 3.0, 2.0], [1, 2, 4], 0),
        ([1.0, 3.0, 2.0, 5.0, 6.0], [1, 4, 9, 12, 8], 0),
    ],
)
def test_integrators_and_a_numerator_of_full_order_without_noise(b, a, integrators, hold):
    """The record begins in the middle of a longer one; an integrating process may start anywhere."""
    n, u = len(a) - 1, steps(1, hold=hold)
    y = simulate_late(b, a, u, DT, 0.0, hold=hold) + (7.0 if integrators else 0.0)
    record = Experiment(u[50:], y[50:], dt=DT, hold=hold)
    theta = fitted(TransferFunction(n, len(b) - 1, integrators=integrators), record)
    np.testing.assert_allclose(theta, np.r_[a[:0:-1][integrators:], b[::-1]], rtol=1e-6)


def test_a_constant_force_on_an_integrating_process_is_its_offset():
    u = steps(2)
    y = simulate_process([3.0], [1, 1, 0], u + 0.2, DT)
    theta = fitted(TransferFunction(2, 0, integrators=1, offset=True), Experiment(u, y, dt=DT))
    np.testing.assert_allclose(theta, [1.0, 3.0, 0.6], rtol=1e-6)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("dead_time", [0.0, 0.015, 0.05, 0.285])
def test_a_dead_time_of_any_length_known_and_estimated(dead_time, hold):
    u = steps(3, hold=hold)
    y = simulate_late([3.0], [1, 4, 3], u, DT, dead_time, hold=hold)
    record, truth = Experiment(u[50:], y[50:], dt=DT, hold=hold), [3.0, 4.0, 3.0]
    known = fitted(TransferFunction(2, 0, dead_time=dead_time), record)
    np.testing.assert_allclose(known, truth, rtol=1e-6)
    found = fitted(TransferFunction(2, 0, dead_time="estimate"), record)
    np.testing.assert_allclose(found, [*truth, dead_time], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_dead_time_at_all_is_one_that_can_be_estimated(seed):
    """Noise would make the dead time negative: at its bound the iteration once never converged."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], 267).repeat(3)
    y = simulate_process((2.0, 1.0), (1.0, 1.2, 6.6), u, DT)
    record = Experiment(u, y + 0.1 * np.std(y) * rng.standard_normal(u.size), dt=DT)
    fit = SRIVC(TransferFunction(2, 1, dead_time="estimate"), Encoder(1.0), DT, 3.0).fit_experiments([record])
    assert fit["dead_time"] == pytest.approx(0.0, abs=0.1 * DT)
    assert fit["a0"] == pytest.approx(6.6, abs=0.1)


def test_a_dead_time_between_uneven_samples():
    rng = np.random.default_rng(4)
    times, u = np.cumsum(DT * rng.uniform(0.5, 1.5, 500)), rng.choice([-1.0, 1.0], 500)
    late = times + 0.113
    merged = np.union1d(times, late)
    driving = np.r_[0.0, u][np.searchsorted(late, merged + 1e-12, side="right")]
    y = simulate_process([3.0], [1, 4, 3], driving, np.diff(merged))[np.searchsorted(merged, times)]
    record = Experiment(u, y, t=times)
    dt = record.period
    for value, truth in ((0.113, [3.0, 4.0, 3.0]), ("estimate", [3.0, 4.0, 3.0, 0.113])):
        estimator = SRIVC(TransferFunction(2, 0, dead_time=value), ONE, dt, 2.0)
        np.testing.assert_allclose(estimator.fit_experiments([record]).theta, truth, rtol=1e-6)


@pytest.mark.parametrize("cls", [LS, BCLS])
def test_filters_take_integrators(cls):
    u = steps(6, 4000)
    y = simulate_process([3.0], [1, 1, 0], u, DT)
    options = {"prefilter_zeros": (-1.0,)} if cls is BCLS else {}
    fit = cls(TransferFunction(2, 0, integrators=1), ONE, DT, 2.0, **options).fit_output(u, y)
    np.testing.assert_allclose(fit.theta, [1.0, 3.0], rtol=1e-3)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("even", [True, False])
def test_what_grows_runs_backward_and_stays_bounded(even, held):
    """The solution backward in time satisfies the equation of the forward solution, so that their difference is a free
    response.
    """
    rng = np.random.default_rng(7)
    F, g = np.array([[0.0, 1.0], [1.6, -1.2]]), np.array([0.0, 1.0])  # poles 0.8 and -2
    grid = Grid(0.01, 400) if even else Grid(rng.uniform(0.005, 0.015, 399), 400)
    w, start = rng.standard_normal((1, 400)), np.ones((2, 1))
    forward, bounded = (run(F, g, grid, w, start, held=held)[:, 0] for run in (respond, respond_bounded))
    growth = np.exp(0.8 * grid.instants)
    free = np.vstack([growth, 0.8 * growth])
    difference = forward - bounded
    decaying = difference - free * (difference[1] + 2 * difference[0])[-1] / (2.8 * growth[-1])
    np.testing.assert_allclose(decaying[1], -2 * decaying[0], atol=1e-9 * np.max(np.abs(difference)))
    longer = Grid(0.01, 40_000)
    assert np.max(np.abs(respond_bounded(F, g, longer, np.ones((1, 40_000)), start, held=held))) < 10


def test_an_unstable_process_under_control():
    """The estimate is exact without noise, over 300 time constants of the pole; with noise in the loop it uses the
    reference.
    """
    r, truth = np.repeat(np.random.default_rng(8).choice([-1.0, 1.0], 500), 8), [-1.6, 1.2, 2.0]
    model = TransferFunction(2, 0, unstable=True)
    noise = 0.1 * np.random.default_rng(9).standard_normal(r.size)
    for v, tolerance in ((0 * noise, 1e-6), (noise, 0.05)):
        u, y = simulate_loop([2.0], [1, 1.2, -1.6], Controller(2.0), r, v, DT)
        fit = SRIVC(model, ONE, DT, 2.0).fit_experiments([Experiment(u, y, dt=DT, reference=r)])
        np.testing.assert_allclose(fit.theta, truth, rtol=tolerance)
    assert np.all(np.abs(fit.theta - truth) < 4 * fit.theta_std)


@pytest.mark.parametrize(
    "name", ["m = n = 2", "two integrators, controlled", pytest.param("dead time 2.5 samples", marks=pytest.mark.long)]
)
def test_cases_of_the_study_reach_the_bound(name):
    runs = [work(name, seed) for seed in range(4)]
    assert np.sqrt(np.mean(np.square([run["bound"] for run in runs]))) < 2.0
    assert np.max(np.abs([run["bar"] for run in runs])) < 4.0
    if "dead" in name:
        assert np.max(np.abs([run["error"][-1] for run in runs])) < 0.01  # a tenth of the sample period


def test_a_first_optimum_is_not_the_last():
    """The process has four resonant poles at 20 dB; from the first filter, the iteration ends 24 units of chi^2 too
    high.
    """
    assert np.max(np.abs(work("m = n = 4", 7)["bar"])) < 4.0


def test_the_explained_input_leaves_out_what_the_record_does_not_support():
    """The noise in the loop is ten times the effect of the reference: two hundred coefficients would explain a seventh
    of it.
    """
    rng = np.random.default_rng(10)
    r, noise = rng.choice([-1.0, 1.0], 1500), rng.standard_normal(1500)
    u = np.convolve(r, [0.5, 0.3, 0.2])[:1500] + 10 * noise
    explained = Experiment(u, u, dt=DT, reference=r).explained_input
    assert explained is not None
    assert abs(np.mean(explained * noise)) < 0.1


def test_processes_with_integrators_and_dead_times_say_what_they_are():
    process = Process(np.array([0.0, 2.0]), np.array([4.0]), np.diag([0.0, 0.01, 0.04, 1e-4]), delay=0.23)
    assert process.delay_std == pytest.approx(0.01)
    assert process.time_constants.tolist() == [np.inf, 0.5]
    assert process.damping.tolist() == [0.0, 1.0]
    assert process.poles_std[0].tolist() == [0.0, 0.0]
    t = np.arange(50) * 0.1
    y, std = process.step_response(t)
    late = np.maximum(t - 0.23, 0.0)
    np.testing.assert_allclose(y, 2 * late - 1 + np.exp(-2 * late), atol=1e-9)
    assert std[2] == 0.0
    assert np.all(std[3:] > 0)


def test_what_cannot_be_says_what_can():
    late, found = TransferFunction(2, 0, dead_time=0.1), TransferFunction(2, 0, dead_time="estimate")
    models = (TransferFunction(2, 2), late, TransferFunction(1, 0, integrators=1))
    assert all(methods_for(model) == ["srivc"] for model in models)
    refused(
        ("integrators must be a whole number from 0 to 2", lambda: TransferFunction(2, 0, integrators=3)),
        ("dead_time must be a time in s, at least 0", lambda: TransferFunction(2, 0, dead_time=-0.1)),
        ("dead_time must be a time in s, at least 0", lambda: TransferFunction(2, 0, dead_time="guess")),
        ("are both given", lambda: TransferFunction(2, 0, dead_time=0.1, delay=2)),
        *(("use srivc", lambda model=model: LS(model, ONE, DT, 2.0)) for model in models),
        ("use srivc", lambda: IV(found, ONE, DT, 2.0)),
    )


CONFIG = """
[record]
input = "u"
output = "y"
dt = 0.05

[model]
kind = "transfer_function"
n = 2
m = 0
integrators = 1
dead_time = "estimate"

[estimator]
cutoff = 2.0
"""


def test_the_command(tmp_path):
    u = steps(11)
    y = simulate_late([3.0], [1, 2, 0], u, DT, 0.085) + 1e-3 * np.random.default_rng(0).standard_normal(u.size)
    np.savetxt(tmp_path / "record.csv", np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    (tmp_path / "axis.toml").write_text(CONFIG, "utf-8")
    arguments = [str(tmp_path / "record.csv"), "--config", str(tmp_path / "axis.toml")]
    result = run_command("identify", *arguments, "--json", "--out", str(tmp_path))
    found = json.loads(result.stdout)
    assert list(found["parameters"]) == ["a1", "b0", "dead_time"]
    assert found["dead_time"] == pytest.approx(0.085, abs=0.002)
    assert found["gain"] is None
    assert found["time_constants"][0] is None
    table = run_command("identify", *arguments)
    assert "dead time" in table.output
    wrong = run_command("identify", *arguments, "--method", "ls", code=2)
    assert "use one of srivc" in wrong.stderr


def test_integrators_alone_have_no_pole_to_find():
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([-1.0, 1.0], 200), 5)
    y = 2.0 * np.r_[0.0, np.cumsum(u)[:-1]] * DT + 1e-3 * rng.standard_normal(u.size)
    model = TransferFunction(n=1, m=0, integrators=1)
    fit = SRIVC(model, Encoder(1.0), DT, cutoff=5.0).fit_experiments([Experiment(u, y, dt=DT)])
    assert fit["b0"] == pytest.approx(2.0, rel=0.02)


def test_a_process_with_integrators_has_the_gain_of_a_derivative():
    """The gain was once printed as "gain inf ± inf"."""
    one = Process(np.array([0.0, 4.0]), np.array([8.0]), np.diag([0.0, 0.04**2, 0.08**2]))
    assert one.slope == ("velocity gain", 2.0, pytest.approx(np.hypot(0.02, 0.02)), "1/s")
    assert "velocity gain 2 ± 0.028 1/s" in repr(one)
    two = Process(np.zeros(2), np.array([3.0]), np.diag([0.0, 0.0, 0.1**2]))
    assert two.slope == ("acceleration gain", 3.0, pytest.approx(0.1), "1/s^2")
    plain = Process(np.array([4.0]), np.array([8.0]), np.diag([0.04**2, 0.08**2]))
    assert plain.slope[:3] == ("gain", plain.gain, pytest.approx(plain.gain_std))
    assert "inf" not in repr(one) + repr(two) + str(one.rows)
