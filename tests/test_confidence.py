"""Transfer functions: error bars for noise of any colour, and findings for records on which no error bar holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, toeplitz
from scipy.signal import lfilter

from pmfid import SRIVC, Encoder, Experiment, NotIdentifiableError, TransferFunction
from pmfid.diagnostics.causality import ResidualStretch, find_feedback, find_unmodelled_response
from pmfid.diagnostics.processes import assess
from pmfid.estimators.srivc import make_problem
from pmfid.linear.experiment import HOLDS
from pmfid.linear.order import UNSTABLE, OrderCandidate, Search, accepted_first
from pmfid.linear.process import Process
from pmfid.linear.residuals import Noise, fit_noise
from pmfid.simulation.process import simulate_process
from studies.process_confidence import estimator_of, identified
from studies.process_records import INPUTS, NOISES, open_record, random_plant

DT = 0.1
LAG = ((2.0,), (1.0, 1.5))


def coloured(rng: np.random.Generator, samples: int, pole: float = 0.9) -> np.ndarray:
    """Return coloured noise of unit variance."""
    return lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], rng.standard_normal(samples + 200))[200:]


def sweep(samples: int) -> np.ndarray:
    t = np.arange(samples) * DT
    return np.sin(0.2 * t + 4.0 * t**2 / (2 * t[-1]))


def parts(u: np.ndarray, residual: np.ndarray) -> list[ResidualStretch]:
    return [ResidualStretch(u[None], residual, np.arange(u.size))]


def none_known(samples: int) -> np.ndarray:
    return np.zeros((samples, 0))


# --- the noise --------------------------------------------------------------------------------------------------------


def test_the_covariance_of_a_sum_is_that_of_the_matrix():
    noise = Noise(np.array([1.6, -0.8]), 1.0, 1.0)
    impulse = lfilter([1.0], noise.whitener, np.r_[1.0, np.zeros(2000)])
    r = [float(impulse[: impulse.size - k] @ impulse[k:]) for k in range(60)]
    weights, place = np.random.default_rng(1).standard_normal((50, 3)), np.r_[0:30, 40:60]
    R = toeplitz(r)[np.ix_(place, place)]
    np.testing.assert_allclose(noise.covariance(weights, place), weights.T @ R @ weights, rtol=1e-6)
    np.testing.assert_allclose(noise.times(weights, place), R @ weights, atol=1e-6 * np.max(np.abs(R)))


def test_missing_samples_are_no_zeros():
    rng = np.random.default_rng(4)
    kept = np.flatnonzero(rng.uniform(size=4000) > 0.3)
    noise = fit_noise(coloured(rng, 4000)[kept], kept)
    slow = noise.variance / np.sum(noise.whitener) ** 2
    assert slow == pytest.approx(19.0, rel=0.35)
    assert noise.power == pytest.approx(1.0, abs=0.25)
    white = fit_noise(rng.standard_normal(kept.size), kept)
    assert white.variance / np.sum(white.whitener) ** 2 == pytest.approx(1.0, rel=0.5)


# --- error bars -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [300, pytest.param(1500, marks=pytest.mark.long)])
def test_bars_hold_for_coloured_noise(samples):
    """Products of the scores under a window once gave bars of the gain that were a third too short at 300 samples."""
    u, z = sweep(samples), []
    clean = simulate_process(*LAG, u, DT)
    estimator = SRIVC(TransferFunction(1, 0), Encoder(1.0), DT, 2.0)
    for seed in range(60):
        y = clean + 0.1 * coloured(np.random.default_rng(seed), samples)
        process = estimator.fit_experiments([Experiment(u, y, dt=DT)]).process
        z.append([(process.gain - 4 / 3) / process.gain_std, (process.poles[0].real + 1.5) / process.poles_std[0, 0]])
    assert np.all(np.abs(np.std(z, axis=0) - 1.0) < 0.25), np.std(z, axis=0)


def test_near_poles_have_the_bars_of_both():
    """The poles of (s + 1)^2 are estimated slightly apart. To first order their error bars are a tenth of the
    distance.
    """
    process = Process(np.array([0.99, 2.0]), np.array([1.0]), np.diag([0.01**2, 1e-12, 1e-12]))
    assert process.poles.real == pytest.approx([-0.9, -1.1])
    assert np.all(process.poles_std[:, 0] > 0.02)
    spread = np.sqrt([0.01 + 0.02, 0.01]) - 0.1  # the discriminant is larger by two standard deviations
    assert process.poles_std[0, 0] == pytest.approx(max(spread[0], 0.1) / 2, rel=0.05)
    apart = replace(process, a=np.array([3.0, 4.0]))
    np.testing.assert_allclose(apart.poles_std[:, 0], 0.005, rtol=0.02)  # value of the delta method


def test_a_variance_that_rounding_makes_negative_is_no_small_bar():
    """An earlier version gave a bar of 0 for the pole, and NaN with a warning for the gain."""
    cov = np.array([[1e6, 1.0, 0.0], [1.0, 1e-7, 0.0], [0.0, 0.0, 1e-8]])
    process = Process(np.array([2.0, 3.0]), np.array([1.0]), cov)
    assert np.all(process.poles_std[:, 0] > np.abs(process.poles))
    worse = Process(np.array([2.0, 3.0]), np.array([1.0]), np.diag([-1e-12, -1e-12, -1e-12]))
    assert worse.gain_std == np.inf
    assert np.all(np.isinf(worse.poles_std[:, 0]))


# --- what the residual knows of the input, and the input of the noise -------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_an_input_that_is_given_makes_no_alarm(seed):
    rng = np.random.default_rng(seed)
    for u in (sweep(800), np.resize(rng.standard_normal(200), 800), np.repeat(rng.choice([-1.0, 1.0], 80), 10)):
        v = coloured(rng, 800)
        assert find_feedback(parts(u, v), none_known(800)).chance > 1e-4
        assert find_unmodelled_response(parts(u, v), none_known(800)).chance > 1e-4


def test_a_model_that_is_too_small_is_no_feedback():
    u = sweep(800)
    lost = simulate_process((1.0,), (1.0, 0.5), u, DT)
    found = parts(u, lost + 0.01 * coloured(np.random.default_rng(1), 800))
    assert find_unmodelled_response(found, none_known(800)).chance < 1e-10
    assert find_feedback(found, none_known(800)).chance > 1e-4


def looped(seed: int, noise: float, reference: str) -> Experiment:
    """Return the record of the lag under proportional control."""
    rng, samples = np.random.default_rng(seed), 1000
    r = sweep(samples) if reference == "sweep" else np.repeat(rng.choice([-1.0, 1.0], samples // 10), 10)
    keep, v = float(expm(np.array([[-1.5 * DT]]))[0, 0]), noise * coloured(rng, samples)
    u, y, x = np.zeros(samples), np.zeros(samples), 0.0
    for k in range(samples):
        y[k] = x + v[k]
        u[k] = 2.0 * (r[k] - y[k])
        x = keep * x + (1 - keep) / 0.75 * u[k]
    return Experiment(u, y, dt=DT)


@pytest.mark.parametrize("reference", ["sweep", "jumps"])
@pytest.mark.parametrize("noise", [0.1, 1e-4])
def test_a_loop_is_found_however_small_the_noise(reference, noise):
    record = looped(3, noise, reference)
    fit = SRIVC(TransferFunction(1, 0), Encoder(1.0), DT, 2.0).fit_experiments([record])
    assert find_feedback(parts(record.u, fit.residual), none_known(1000)).chance < 1e-6


# --- what the status and the search say -------------------------------------------------------------------------------


def test_an_estimate_on_the_noise_is_uncertain():
    """On 300 samples a model of four poles fits a pair to the ringing noise, with a bar of a hundredth of the value."""
    rng = np.random.default_rng([4, INPUTS.index("sweep"), NOISES.index("resonance")])
    plant, hold = random_plant(rng), ("zoh", "foh")[int(rng.integers(2))]
    record = open_record(plant, "sweep", "resonance", 300, hold, rng)
    process, _, status = identified(estimator_of(plant), record)
    z = (process.poles - plant.poles) / process.poles_std[:, 0]
    assert np.max(np.abs(z)) > 20
    assert "uncertain" in status


def test_a_pole_and_a_zero_that_cancel_are_named():
    """The pair may be anywhere. Far out, the search ends where one coefficient has no effect of its own."""
    rng, u = np.random.default_rng(5), np.repeat(np.random.default_rng(6).choice([-1.0, 1.0], 120), 10)
    y = simulate_process(*LAG, u, DT) + 0.05 * rng.standard_normal(u.size)
    model = TransferFunction(2, 1)
    try:
        doubt = " ".join(identified(SRIVC(model, Encoder(1.0), DT, 2.0), Experiment(u, y, dt=DT))[2])
    except NotIdentifiableError as error:
        doubt = str(error)
    assert doubt == "uncertain" or "the order of the model is too high" in doubt
    assert identified(SRIVC(TransferFunction(1, 0), Encoder(1.0), DT, 2.0), Experiment(u, y, dt=DT))[2] == ()


def test_poles_that_follow_the_noise_are_uncertain_beside_an_unknown_dead_time():
    """A pair of poles and the dead time settle on a resonance of the noise, 70 standard errors from the process."""
    rng = np.random.default_rng([977, 13, 4])
    plant = random_plant(rng, 4)
    record = open_record(plant, "multisine", "resonance", 1000, HOLDS[int(rng.integers(2))], rng)
    late = replace(record, y=np.r_[np.zeros(5), record.y[:-5]])
    model = TransferFunction(plant.a.size - 1, plant.b.size - 1, dead_time="estimate")
    assert "uncertain" in identified(estimator_of(plant, model), late)[2]


@pytest.mark.parametrize("made", ["zoh", "foh"])
@pytest.mark.parametrize("kind", ["sweep", "multisine"])
def test_a_wrong_hold_is_unmodelled_and_no_feedback(made, kind):
    plant = random_plant(np.random.default_rng(1), 1)
    record = open_record(plant, kind, "white", 1000, made, np.random.default_rng(2))
    assert identified(estimator_of(plant), record)[2] == ()
    other = replace(record, hold={"zoh": "foh", "foh": "zoh"}[made])
    assert identified(estimator_of(plant), other)[2] == ("unmodelled",)


def test_a_numerator_that_is_not_known_is_no_reason_to_refuse():
    """With two zeros too many, the numerator's coefficients are arbitrary, but the response is right to 99 %."""
    rng, u = np.random.default_rng(3), sweep(400)
    y = simulate_process(*LAG, u, DT) + 0.01 * coloured(rng, 400)
    estimator, record = SRIVC(TransferFunction(2, 1), Encoder(1.0), DT, 2.0), Experiment(u, y, dt=DT)
    checks = assess(make_problem(estimator, [record]), _scaled_theta(estimator, record))
    assert checks.fit > 98
    assert checks.depends
    noise = replace(record, y=coloured(rng, 400))
    assert not assess(make_problem(estimator, [noise]), _scaled_theta(estimator, noise)).depends


def _scaled_theta(estimator: SRIVC, record: Experiment) -> np.ndarray:
    problem = make_problem(estimator, [record])
    return estimator.fit_experiments([record]).theta / problem.structure.scale(problem.rate)


def test_the_search_puts_one_that_is_accepted_first():
    rows = tuple(OrderCandidate(n, 0, 0, float(n), 90.0, 1.0, True, True, np.ones(n + 1), 100) for n in (1, 2, 3))
    found = accepted_first(Search(rows, 0, 100), lambda row: {1: UNSTABLE, 2: "does not converge"}.get(row.n, ""))
    assert [row.n for row in found.candidates] == [3, 1, 2]
    assert [row.refused for row in found.candidates] == ["", UNSTABLE, "does not converge"]
    none = accepted_first(Search(rows, 0, 100), lambda row: UNSTABLE if row.n == 2 else "does not converge")
    assert none.best.n == 2
