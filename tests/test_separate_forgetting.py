"""Forgetting by parameter, against the recursion for P and in its applications."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid import BCRLS, RLS, TransferFunction, UsageError
from pmfid.simulation.process import simulate_process
from studies.late_processes import simulate_varying
from tests.conftest import CART_DT, cart_run
from tests.test_transfer_function import LAG, build, make_record


def test_is_the_recursion_with_p_spread_by_parameter(drive):
    """The recursion is P = D^-1 (P - K phi^T P) D^-1, where D holds the roots of the factors (Saelid and Foss 1983)."""
    run = cart_run(1, samples=1500, increments=1024)
    factors = {"viscous_friction": 0.999, "coulomb_friction": 1.0}
    estimator = RLS(drive, run.encoder, CART_DT, 33.0, forgetting=0.99, forgetting_of=factors)
    track = estimator.run(run.u, run.counts)
    columns, status = estimator.make_kernel(0.99).filter(run.u, run.counts)
    start = int(np.flatnonzero(track.theta[:, 0])[0])
    phi, z = columns[:, :3], columns[:, 3]
    first = int(np.flatnonzero((status & pmfid.Status.SETTLING) == 0)[0])
    weights = 0.99 ** np.arange(start - first, -1, -1.0)
    information = (phi[first : start + 1] * weights[:, None]).T @ phi[first : start + 1]
    theta = np.linalg.solve(information, (phi[first : start + 1] * weights[:, None]).T @ z[first : start + 1])
    keep = np.sqrt([0.99, 0.999, 1.0])
    for k in range(start + 1, run.u.size):
        information = keep[:, None] * information * keep + np.outer(phi[k], phi[k])
        theta = theta + np.linalg.solve(information, phi[k] * (z[k] - phi[k] @ theta))
    np.testing.assert_allclose(
        track.theta[-1], theta, rtol=2e-3
    )  # the regularisation of the kernel makes the difference


def test_the_same_factor_for_all_is_plain_forgetting():
    run = make_record(LAG, 1, snr=20.0)
    same = {"a0": 0.99, "a1": 0.99, "b0": 0.99}
    for cls in (RLS, BCRLS):
        plain, separate = (
            build(cls, LAG, run, forgetting=0.99, **options).run(run.u, run.counts).theta[-1]
            for options in ({}, {"forgetting_of": same})
        )
        np.testing.assert_allclose(separate, plain, rtol=1e-6)


def test_a_parameter_that_stays_sharpens_the_others():
    run = make_record(LAG, 2, snr=10.0)
    spread = [
        np.std(build(BCRLS, LAG, run, forgetting=0.99, **options).run(run.u, run.counts)["a1"][1000:])
        for options in ({}, {"forgetting_of": {"b0": 1.0}})
    ]
    assert spread[1] < 0.6 * spread[0]


def test_simulated_process_that_does_not_vary_is_the_one_that_cannot():
    u = np.random.default_rng(0).choice([-1.0, 1.0], 300)
    varying = simulate_varying(lambda t: np.array([3.0, 4.0, 3.0]), 2, u, 0.05)
    np.testing.assert_allclose(varying, simulate_process((3.0,), (1.0, 4.0, 3.0), u, 0.05), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"forgetting_of": {"b1": 1.0}}, "got 1.0 for 'b1'"),
        ({"forgetting_of": {"b0": 0.9}}, "from forgetting = 0.99 to 1"),
        ({"forgetting_of": {"b0": 1.1}}, "to 1"),
        ({"forgetting_of": {"b0": 1.0}, "forgetting_scheme": "window"}, "exponential scheme"),
    ],
)
def test_wrong_factors_are_refused(options, message):
    with pytest.raises(UsageError, match=message):
        RLS(TransferFunction(2, 0), pmfid.Encoder(1e-6), 0.01, 10.0, forgetting=0.99, **options)
