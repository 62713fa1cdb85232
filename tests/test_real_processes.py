"""Transfer functions of real records: integrators, m = n, dead times of any length, unstable poles under control."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.linear.experiment import Grid, respond
from pmfid.linear.responses import respond_bounded
from studies.late_processes import Controller, simulate_late, simulate_loop
from tests.command import run_command

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
