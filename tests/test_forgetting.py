"""Forgetting schemes against sums over the samples that each scheme keeps."""

from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.errors import UsageError
from pmfid.estimators.recursive import FORGETTING_SCHEMES
from pmfid.simulation import CART, CART_DT, Schedule, prbs, quantize, resolution_of, simulate_drive
from pmfid.status import Status

CUTOFF, FORGETTING = 50.0, 0.99
RECURSIVE = (pmfid.RLS, pmfid.BCRLS, pmfid.RIV)
UNSUITED = {(cls, "directional") for cls in (pmfid.BCRLS, pmfid.RIV)}
CASES = [(cls, scheme) for cls in RECURSIVE for scheme in FORGETTING_SCHEMES if (cls, scheme) not in UNSUITED]


def gap_record(increments=4096, still=3000, coast=3000, head=2000):
    """Return u, counts, resolution and the start of the last part. The parts are a PRBS, a rest, constant speed, and a
    PRBS with another mass."""
    moves = prbs(2 * head, clock=10, amplitude=3.0, rng=np.random.default_rng(3))
    u = np.r_[moves[:head], np.zeros(still), np.ones(coast), moves[head:]]
    change = head + still + coast
    loaded = Schedule(((0.0, CART), (change * CART_DT, replace(CART, mass=1.44))))
    resolution = resolution_of(increments)
    return u, quantize(simulate_drive(loaded, u, CART_DT).x, resolution), resolution, change


def make(cls, scheme, resolution, precision="float64"):
    options = {"forgetting": FORGETTING, "forgetting_scheme": scheme, "precision": precision}
    return cls(pmfid.Drive(CART.input_gain), pmfid.Encoder(resolution), CART_DT, CUTOFF, **options)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(("cls", "scheme"), CASES)
def test_every_scheme_survives_a_gap_and_finds_the_new_mass(cls, scheme, precision):
    u, counts, resolution, change = gap_record()
    track = make(cls, scheme, resolution, precision).run(u, counts)
    assert np.all(np.isfinite(track.theta))
    np.testing.assert_allclose(track["mass"][1000:2000], CART.mass, rtol=0.005)
    np.testing.assert_allclose(track["mass"][2000 : change - 1], CART.mass, rtol=0.06)
    np.testing.assert_allclose(track["mass"][-1], 1.44, rtol=0.01)


@pytest.mark.parametrize(("cls", "scheme"), CASES)
def test_step_by_step_gives_the_bits_of_run(cls, scheme):
    u, counts, resolution, _ = gap_record(still=50, coast=50, head=600)
    whole = make(cls, scheme, resolution).run(u, counts)
    single = make(cls, scheme, resolution)
    steps = np.array([single.step(float(a), int(b)).theta for a, b in zip(u, counts, strict=True)])
    assert np.array_equal(steps, whole.theta)


def test_the_window_is_the_least_squares_solution_of_its_samples():
    """The window holds 7 full blocks and a partial block, with ceil(100 / 7.5) = 14 samples in a block."""
    u, counts, resolution, _ = gap_record(still=0, coast=0, head=400)
    estimator = make(pmfid.RLS, "window", resolution)
    track = estimator.run(u, counts)
    columns = pmfid.LS(pmfid.Drive(CART.input_gain), estimator.encoder, CART_DT, CUTOFF).columns(u, counts)
    block, n = 14, columns.z.size - estimator.delay
    samples = 7 * block + n % block
    assert n > 8 * block
    theta = np.linalg.lstsq(columns.phi[n - samples : n], columns.z[n - samples : n])[0]
    np.testing.assert_allclose(
        track.theta[-1], theta, rtol=2e-6
    )  # the late regularisation of the kernel causes a difference
    assert not np.allclose(theta, np.linalg.lstsq(columns.phi, columns.z)[0], rtol=1e-5)


def test_constant_trace_keeps_the_mean_of_p():
    u, counts, resolution, _ = gap_record(still=0, coast=0)
    track = make(pmfid.RLS, "constant-trace", resolution).run(u, counts)
    first = int(np.flatnonzero(~track.has_status(Status.STARTING))[0])
    settling = int(np.flatnonzero(~track.has_status(Status.SETTLING))[0])
    reference = track.variance_factor[settling + round(1 / (1 - FORGETTING)) - 1]
    trace = np.mean(track.variance_factor[first + 200 :] / reference, axis=1)
    assert 0.95 < np.median(trace) < 1.05
    assert trace.min() > 0.5
    assert trace.max() < 1.5
    exponential = make(pmfid.RLS, "exponential", resolution).run(u, counts)
    other = np.mean(exponential.variance_factor[first + 200 :] / reference, axis=1)
    assert abs(np.median(trace) - 1) < abs(np.median(other) - 1)


def test_without_forgetting_the_scheme_makes_no_difference():
    u, counts, resolution, _ = gap_record(still=0, coast=0, head=400)
    tracks = [
        pmfid.RIV(
            pmfid.Drive(CART.input_gain), pmfid.Encoder(resolution), CART_DT, CUTOFF, forgetting_scheme=scheme
        ).run(u, counts)
        for scheme in ("exponential", "window", "constant-trace")
    ]
    assert np.array_equal(tracks[0].theta, tracks[1].theta)
    assert np.array_equal(tracks[0].theta, tracks[2].theta)


@pytest.mark.parametrize(("cls", "scheme"), sorted(UNSUITED, key=str))
def test_a_scheme_that_does_not_suit_a_method_is_refused_with_the_remedy(cls, scheme):
    with pytest.raises(UsageError, match=rf"{scheme}.*(window)"):
        make(cls, scheme, 1e-5)


def test_an_unknown_scheme_is_named():
    with pytest.raises(UsageError, match=r"forgetting_scheme must be one of.*'fading'"):
        make(pmfid.RLS, "fading", 1e-5)
