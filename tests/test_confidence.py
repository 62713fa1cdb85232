"""Transfer functions: error bars for noise of any colour, and findings for records on which no error bar holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.diagnostics.causality import ResidualStretch, chance_of_feedback
from pmfid.simulation.process import simulate_process
from studies.process_records import estimator_of, identified, open_record, random_plant

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


# --- what the residual knows of the input, and the input of the noise -------------------------------------------------


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
    assert chance_of_feedback(parts(record.u, fit.residual), none_known(1000)) < 1e-6


# --- what the status and the search say -------------------------------------------------------------------------------


@pytest.mark.parametrize("made", ["zoh", "foh"])
@pytest.mark.parametrize("kind", ["sweep", "multisine"])
def test_a_wrong_hold_is_unmodelled_and_no_feedback(made, kind):
    plant = random_plant(np.random.default_rng(1), 1)
    record = open_record(plant, kind, "white", 1000, made, np.random.default_rng(2))
    assert identified(estimator_of(plant), record)[2] == ()
    other = replace(record, hold={"zoh": "foh", "foh": "zoh"}[made])
    assert identified(estimator_of(plant), other)[2] == ("unmodelled",)
