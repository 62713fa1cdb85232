"""Recursive refined instrumental variables of a process that rings for long: active, near the optimum, honest."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pmfid import RSRIVC, SRIVC, Encoder, Experiment, Status, TransferFunction
from pmfid.encoder import fine_counts
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.simulation.process import simulate_process
from tests.conftest import long_unless

DT, CUTOFF, RATE = 0.03, 9.0, 6.0
#: Samples before the record: an odd seed begins in motion.
BEFORE = 1500


def record(damping: float, samples: int, seed: int, snr: float) -> Experiment:
    """Simulate a resonance of 6 rad/s under a random binary input; `snr` is in dB, and odd seeds begin in motion."""
    rng = np.random.default_rng([seed, round(1e4 * damping)])
    before = BEFORE * (seed % 2)
    u = rng.choice([-1.0, 1.0], (samples + before) // 4 + 1).repeat(4)[: samples + before]
    y = simulate_process((40.0,), (1.0, 2 * damping * RATE, RATE**2), u, DT)[before:]
    return Experiment(u[before:], y + np.std(y) * 10 ** (-snr / 20) * rng.standard_normal(samples), dt=DT)


def last(run: Experiment, damping: float, **options):
    """Return errors, error bars, and the status at the end."""
    encoder, counts = fine_counts(run.y)
    estimator = RSRIVC(TransferFunction(2, 0), encoder, DT, CUTOFF, **options)
    zeros = choose_prefilter_zeros(estimator, run.u, counts)
    track = RSRIVC(TransferFunction(2, 0), encoder, DT, CUTOFF, prefilter_zeros=zeros, **options).run(run.u, counts)
    truth = np.array([RATE**2, 2 * damping * RATE, 40.0])
    return track.theta[-1] - truth, track.theta_std[-1], int(track.status[-1])


@pytest.mark.parametrize(
    ("damping", "samples"),
    long_unless(
        lambda damping, samples: (samples == 1500) == (damping in (0.01, 0.1)),
        product([0.01, 0.02, 0.05, 0.1], [1500, 4000]),
    ),
)
def test_light_damping_is_no_reason_to_fall_back(damping, samples):
    """At a damping of 1 %, 1500 samples are less than three decay times."""
    runs = [last(record(damping, samples, seed, 20.0), damping) for seed in range(5)]
    assert sum(bool(status & Status.FALLBACK) for *_, status in runs) <= 1
    assert all(np.all(np.abs(error) < 4 * bar) for error, bar, _ in runs)


def test_filters_of_their_own_cost_data_little():
    """The errors are at most twice those of the best off-line estimate, in the median."""
    damping, ratios = 0.03, []
    for seed in range(8):
        run = record(damping, 4000, seed, 20.0)
        best = SRIVC(TransferFunction(2, 0), Encoder(1.0), DT, CUTOFF).fit_experiments([run])
        ratios.append(np.abs(last(run, damping)[0]) / best.theta_std)
    assert np.all(np.median(ratios, axis=0) / 0.6745 < 2.5), np.median(ratios, axis=0)


@pytest.mark.parametrize(("precision", "within"), [("float64", 1e-6), ("float32", 1e-3)])
def test_without_noise_those_filters_make_no_error_of_the_discretisation(precision, within):
    """The decay takes 560 samples and the filters take 20. The discrete equation treats both alike."""
    run = record(0.01, 6000, 1, 200.0)
    error, _, status = last(run, 0.01, forgetting=0.997, precision=precision)
    assert status == 0
    np.testing.assert_allclose(error / [RATE**2, 2 * 0.01 * RATE, 40.0], 0.0, atol=within)
