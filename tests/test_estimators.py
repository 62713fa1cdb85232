"""The estimates against the true physical parameters of the cart."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid import Status
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.estimators.plants import default_zeros
from pmfid.simulation.scenarios import make_scenario
from tests.conftest import TRUTH, cart_run
from tests.refusals import refused

DT, CUTOFF = 0.01, 50.0
SEEDS = range(10)


def errors(cls, drive, increments, **options):
    """Return the mean relative error over the seeds, at the end of a record of 30 s."""
    found = []
    for seed in SEEDS:
        run = cart_run(seed, increments=increments)
        estimator = cls(drive, run.encoder, DT, CUTOFF, **options)
        if hasattr(estimator, "fit"):
            found.append(estimator.fit(run.u, run.counts).theta[:3])
        else:
            found.append(estimator.run(run.u, run.counts).theta[-1, :3])
    return np.mean(found, axis=0) / TRUTH - 1


def test_matched_filters_without_noise(drive):
    error = errors(pmfid.LS, drive, None)
    assert abs(error[0]) < 5e-4
    assert abs(error[1]) < 5e-3


def test_the_papers_discretisation_shows_its_error(drive):
    error = errors(pmfid.LS, drive, None, discretization="paper")
    assert -0.015 < error[0] < -0.003


@pytest.mark.parametrize("cls", [pmfid.BCLS, pmfid.BCRLS])
def test_compensation_at_256_increments(cls, drive):
    assert abs(errors(cls, drive, 256)[0]) < 3e-3


@pytest.mark.parametrize("cls", [pmfid.LS, pmfid.RLS])
def test_without_compensation_the_mass_is_too_small(cls, drive):
    """Plain least squares has a small bias, and the extended model before the compensation (paper eq. 21) has a large
    bias.
    """
    assert errors(cls, drive, 256)[0] < -4e-3
    assert errors(cls, drive, 256, prefilter_zeros=default_zeros(CUTOFF))[0] < -0.1


@pytest.mark.parametrize("increments", [4096, 1024, 512, 256])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_bcrls_on_line_never_leaves_the_plausible(increments, precision, drive):
    """The mass steps from 1.07 to 1.44 kg; from 1 s on no estimate is outside 0.8 to 1.7 kg."""
    for seed in range(5):
        scenario = make_scenario("mass-step", seed=seed, increments=increments)
        encoder = pmfid.Encoder(scenario.resolution)
        track = pmfid.BCRLS(drive, encoder, DT, CUTOFF, forgetting=0.99, precision=precision).run(
            scenario.motion.u, scenario.counts
        )
        mass = track["mass"][100:]
        assert np.all(np.isfinite(track.theta))
        assert mass.min() > 0.8
        assert mass.max() < 1.7
        assert mass[-1] == pytest.approx(1.44, rel=0.02)
        assert not np.any(track.status[100:] & (Status.POOR_EXCITATION | Status.STARTING))


def test_zeros_chosen_from_a_record_are_no_worse(drive):
    run = cart_run(1, increments=256)
    estimator = pmfid.BCLS(drive, run.encoder, DT, CUTOFF)
    zeros = choose_prefilter_zeros(estimator, run.u, run.counts)
    chosen = pmfid.BCLS(drive, run.encoder, DT, CUTOFF, prefilter_zeros=zeros).fit(run.u, run.counts)
    fast = pmfid.BCLS(drive, run.encoder, DT, CUTOFF, prefilter_zeros=(-120.0, -60.0)).fit(run.u, run.counts)
    assert np.linalg.det(chosen.theta_cov) < np.linalg.det(fast.theta_cov)


def test_no_motion_and_no_excitation_are_said(drive):
    batch = pmfid.LS(drive, pmfid.Encoder(1e-5), DT, CUTOFF)
    refused(
        ("does not move", lambda: batch.fit(np.ones(1000), np.zeros(1000, int))),
        (r"viscous_friction|coulomb_friction", lambda: batch.fit(np.full(1000, 1.0), np.arange(1000) * 10)),
        ("too few", lambda: batch.fit(np.ones(20), np.arange(20))),
        kind=pmfid.NotIdentifiableError,
    )


def test_wrong_arguments_say_the_remedy(drive):
    """The contract covers that every method refuses these arguments."""
    encoder = pmfid.Encoder(1e-5)

    def made(cls=pmfid.BCRLS, **wrong):
        return cls(drive, encoder, **({"dt": DT, "cutoff": CUTOFF} | wrong))

    estimator = made(pmfid.RLS)
    refused(
        ("at most 200", lambda: made(cutoff=201.0)),
        ("rad/s", lambda: made(cutoff=-1.0)),
        ("finite", lambda: made(cutoff=np.nan)),
        ("sample period", lambda: made(dt=0.0)),
        ("at least 2", lambda: made(order=1)),
        ("matched", lambda: made(discretization="zoh")),
        ("float32", lambda: made(precision="half")),
        *(("different negative", lambda z=z: made(prefilter_zeros=z)) for z in ((-1.0,), (-1.0, 1.0), (-1.0, -1.0))),
        *(("1 - dt/T", lambda f=f: made(pmfid.RLS, forgetting=f)) for f in (0.0, -0.1, 1.2, np.nan)),
        ("resolution", lambda: pmfid.Encoder(0.0)),
        ("resolution", lambda: pmfid.Encoder(-1e-6)),
        ("bits", lambda: pmfid.Encoder(1e-5, bits=0)),
        ("bits", lambda: pmfid.Encoder(1e-5, bits=33)),
        ("max_speed", lambda: pmfid.Encoder(1e-5, max_speed=0.0)),
        ("standstill_time", lambda: pmfid.Encoder(1e-5, standstill_time=-1.0)),
        ("same length", lambda: estimator.run(np.zeros(3), np.zeros(4, int))),
        ("quantize", lambda: estimator.run(np.zeros(3), np.array([0.0, 0.5, 1.0]))),
    )
