"""Transfer functions off-line: exact without noise, honest with noise, and robust to faulty data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid import SRIVC, Drive, Encoder, Experiment, NotIdentifiableError, TransferFunction
from pmfid.diagnostics.processes import Assessment, assess
from pmfid.estimators.srivc import make_problem
from pmfid.linear.process import Process
from pmfid.simulation.process import PLANTS, SimulatedProcess, simulate_process
from studies.second_order import write
from tests.command import run_command
from tests.refusals import refused

ENCODER = Encoder(1.0)
CONFIG = Path(__file__).parents[1] / "examples" / "second_order.toml"
SECOND, HARD = PLANTS["second-order"], PLANTS["rao-garnier"]


def srivc(plant: SimulatedProcess, **options: int) -> SRIVC:
    model = TransferFunction(len(plant.a) - 1, len(plant.b) - 1, **options)
    return SRIVC(model, ENCODER, plant.dt, plant.cutoff)


def noisy(plant: SimulatedProcess, seed: int, ratio: float = 0.1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return plant.y + ratio * np.std(plant.y) * rng.standard_normal(plant.samples)


def assessed(estimator: SRIVC, experiments: list[Experiment]) -> Assessment:
    fit = estimator.fit_experiments(experiments)
    problem = make_problem(estimator, experiments)
    return assess(problem, fit.theta / problem.structure.scale(problem.rate))


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_exact_without_noise(plant):
    fit = srivc(plant).fit_experiments([Experiment(plant.u, plant.y, dt=plant.dt)])
    np.testing.assert_allclose(fit.theta, plant.theta, rtol=1e-6)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_exact_with_uneven_steps_gaps_delay_and_any_start(hold):
    """The record starts in the middle and has three stretches: the input is unknown for a while, and the clock
    jumps.
    """
    rng = np.random.default_rng(1)
    n = 1500
    steps = SECOND.dt * rng.uniform(0.6, 1.4, n - 1)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 3), 3)
    y = simulate_process(SECOND.b, SECOND.a, u, steps, hold=hold)
    t = np.r_[0.0, np.cumsum(steps)]
    t[1000:] += 7.0
    y[rng.uniform(size=n) < 0.1] = np.nan
    y[999] = np.nan  # the step of this sample is the gap
    u[500:503] = np.nan
    part = slice(40, None)
    experiment = Experiment(u[part], y[part], t=t[part], hold=hold)
    fit = srivc(SECOND).fit_experiments([experiment])
    np.testing.assert_allclose(fit.theta, SECOND.theta, rtol=1e-6)


@pytest.mark.long
def test_error_bars_are_those_of_many_runs():
    fits = [
        srivc(SECOND).fit_experiments([Experiment(SECOND.u, noisy(SECOND, s, 0.3), dt=SECOND.dt)]) for s in range(40)
    ]
    theta = np.array([fit.theta for fit in fits])
    z = (theta - SECOND.theta) / np.array([fit.theta_std for fit in fits])
    assert np.all(np.abs(z.mean(axis=0)) < 0.6), z.mean(axis=0)
    assert np.all((z.std(axis=0) > 0.7) & (z.std(axis=0) < 1.4)), z.std(axis=0)
    poles = np.array([fit.process.poles.real for fit in fits])
    stated = np.mean([fit.process.poles_std[:, 0] for fit in fits], axis=0)
    np.testing.assert_allclose(stated, poles.std(axis=0), rtol=0.35)
    gains = np.std([fit.process.gain for fit in fits])
    assert np.mean([fit.process.gain_std for fit in fits]) == pytest.approx(gains, rel=0.35)


def closed_loop(seed: int, samples: int = 4000, dt: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return r, u, y of the second plant of Ljung's kind, 2 / (s^2 + s + 2), after a gain of 3, with coloured noise in
    the loop.
    """
    from scipy.linalg import expm

    rng = np.random.default_rng(seed)
    block = np.zeros((3, 3))
    block[:2] = [[0, 1, 0], [-2, -1, 2]]
    move = expm(block * dt)
    r = np.repeat(rng.choice([-1.0, 1.0], samples // 20), 20)
    u, y, x, v = np.zeros(samples), np.zeros(samples), np.zeros(2), 0.0
    for k in range(samples):
        v = 0.95 * v + 0.6 * np.sqrt(1 - 0.95**2) * rng.standard_normal()
        y[k] = x[0] + v
        u[k] = 3 * (r[k] - y[k])
        x = move[:2, :2] @ x + move[:2, 2] * u[k]
    return r, u, y


@pytest.mark.long
def test_closed_loop_needs_the_reference():
    estimator = SRIVC(TransferFunction(2, 0), ENCODER, 0.05, 2.0)
    without, given = [], []
    for seed in range(6):
        r, u, y = closed_loop(seed)
        plain = Experiment(u, y, dt=0.05)
        without.append(estimator.fit_experiments([plain]).theta)
        given.append(estimator.fit_experiments([replace(plain, reference=r)]).theta)
        assert assessed(estimator, [plain]).feedback
    bias, left = (np.mean(found, axis=0) / [2, 1, 2] - 1 for found in (without, given))
    assert np.max(np.abs(left)) < 0.05 < np.max(np.abs(bias)), (bias, left)


def test_residual_tests():
    right = assessed(srivc(SECOND), [Experiment(SECOND.u, noisy(SECOND, 5), dt=SECOND.dt)])
    assert (right.white, right.independent, right.feedback) == (True, True, False)
    assert right.fit == pytest.approx(90.0, abs=0.5)
    small = replace(SECOND, a=(1.0, 1.0), b=(1.0,))
    wrong = assessed(srivc(small), [Experiment(SECOND.u, noisy(SECOND, 5), dt=SECOND.dt)])
    assert (wrong.white, wrong.independent) == (False, False)


def test_process_agrees_with_scipy_and_control():
    process = Process(np.array([2.0, 1.0]), np.array([-2.0, 3.0]), 1e-4 * np.eye(4), delay=0.1)
    pytest.importorskip("control")
    system, other = process.to_scipy(), process.to_control()
    w = np.array([0.1, 1.0, 10.0])
    G, size, _ = process.frequency_response(w)
    np.testing.assert_allclose(G, system.freqresp(w)[1] * np.exp(-0.1j * w), rtol=1e-9)
    np.testing.assert_allclose(other(1j * w) * np.exp(-0.1j * w), G, rtol=1e-9)
    t = np.linspace(0, 5, 501)
    y, std = process.step_response(t)
    np.testing.assert_allclose(y[10:], system.step(T=t)[1][:-10], atol=1e-9)
    rng = np.random.default_rng(0)
    drawn = []
    for change in rng.multivariate_normal(np.zeros(4), process.cov, 400):
        other = replace(process, a=process.a + change[:2], b=process.b + change[2:])
        drawn.append((np.abs(other.frequency_response(w)[0] / G), other.step_response(t)[0][100]))
    np.testing.assert_allclose(np.std([size for size, _ in drawn], axis=0), size, rtol=0.15)
    assert np.std([value for _, value in drawn]) == pytest.approx(std[100], rel=0.15)
    assert process.gain == -1.0
    assert process.zeros == pytest.approx([2 / 3])
    assert "3 s - 2" in str(process)
    assert "time constant" in repr(process)
    assert process._repr_latex_().startswith("$G(s)")


def experiment(u: object, y: object, **options: object) -> Experiment:
    return Experiment(u, y, **({} if "t" in options else {"dt": 1.0}) | options)


def test_what_cannot_be_identified_says_so():
    estimator, n, none, dt = srivc(SECOND), np.ones(500), np.full(500, np.nan), SECOND.dt
    record = Experiment(SECOND.u, SECOND.y, dt=dt)
    process = estimator.fit_experiments([record]).process
    refused(
        ("does not move", lambda: estimator.fit_experiments([Experiment(n, 0 * n, dt=dt)])),
        ("input is always zero", lambda: estimator.fit_experiments([Experiment(0 * n, np.cumsum(n), dt=dt)])),
        kind=NotIdentifiableError,
    )
    refused(
        ("record longer", lambda: estimator.fit_experiments([Experiment(np.ones(3), np.ones(3), dt=dt)])),
        ("works on a transfer function", lambda: SRIVC(Drive(2.0), ENCODER, 0.01, 50.0)),
        ("the output is empty", lambda: estimator.fit_experiments([Experiment(n, none, dt=dt)])),
        ("the input is empty", lambda: estimator.fit_experiments([Experiment(none, n, dt=dt)])),
        *(("a list of Experiments", lambda x=x: estimator.fit_experiments(x)) for x in (record, [], None, [SECOND.u])),
        *(("^t ", lambda t=t: process.step_response(t)) for t in (5, [0.0], [0.0, 0.0], [1.0, 2.0], "a")),
        ("frequencies must be real numbers", lambda: process.frequency_response("a")),
    )


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def records(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("records")
    for seed in (0, 1):
        write(folder / f"{seed}.csv", seed)
    return [str(folder / f"{seed}.csv") for seed in (0, 1)]


def run(*arguments: str, code: int = 0) -> str:
    result = run_command(*arguments, code=code)
    return result.stdout if code == 0 else result.stderr


@pytest.mark.parametrize("method", ["auto", "srivc", "bcls", "rls"])
def test_identify_json(records, method):
    found = json.loads(run("identify", records[0], "--config", str(CONFIG), "--json", "--method", method))
    assert [found["a0"], found["a1"], found["b0"]] == pytest.approx([3, 4, 3], rel=0.05)
    assert sorted(pole for pole, _ in found["poles"]) == pytest.approx([-3, -1], rel=0.08)
    assert found["fit"] == pytest.approx(90, abs=1)
