"""Without noise, the exact discretisation has no error, and the other discretisations have an order of convergence."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid import BCLS, LS, Drive, Encoder, TransferFunction
from pmfid.estimators import ls as exact
from pmfid.simulation.process import PLANTS, simulate_process
from pmfid.simulation.signals import prbs
from studies.discretizations import plant_at_random, record_of
from tests.conftest import long_unless
from tests.refusals import refused
from tests.tuned import set_tuning

ENCODER = Encoder(1.0)  # fit_output does not use the encoder


@pytest.mark.parametrize("cls", [LS, BCLS])
@pytest.mark.parametrize(
    ("n", "r", "fastest"),
    long_unless(
        lambda n, r, fastest: fastest == (0.01, 0.1, 0.3)[(n + r) % 3],
        [(n, r, fastest) for n in range(1, 5) for r in range(1, min(n, 3) + 1) for fastest in (0.01, 0.1, 0.3)],
    ),
)
def test_exact_without_noise_after_six_passes(cls, n, r, fastest, monkeypatch):
    set_tuning(monkeypatch, exact, ls_passes=6)
    plant = plant_at_random(n, r, fastest, seed=100 * n + 10 * r)
    u, y = record_of(plant, seed=1)
    estimator = cls(TransferFunction(n, n - r), ENCODER, plant.dt, plant.cutoff, discretization="exact")
    np.testing.assert_allclose(estimator.fit_output(u, y).theta, plant.theta, rtol=1e-6)


@pytest.mark.parametrize("cls", [LS, BCLS])
def test_drive_without_stops(cls, monkeypatch):
    set_tuning(monkeypatch, exact, ls_passes=6)
    mass, viscous, coulomb, gain, dt = 1.07, 12.8, 0.8, 2.0, 0.01
    u = 3.0 + prbs(3000, clock=10, amplitude=1.5, rng=np.random.default_rng(3))
    y = simulate_process([1.0], [mass, viscous, 0.0], gain * u - coulomb, dt)
    estimator = cls(Drive(gain), ENCODER, dt, 50.0, discretization="exact")
    np.testing.assert_allclose(estimator.fit_output(u, y).theta, [mass, viscous, coulomb], rtol=1e-6)


def test_offset_and_delay():
    plant = PLANTS["second-order"]
    u = plant.u
    late = np.r_[np.zeros(3), u[:-3]]
    y = simulate_process(plant.b, plant.a, late, plant.dt) + simulate_process([1.0], plant.a, np.ones(u.size), plant.dt)
    model = TransferFunction(2, 0, delay=3, offset=True)
    fit = LS(model, ENCODER, plant.dt, plant.cutoff, discretization="exact").fit_output(u, y)
    np.testing.assert_allclose(fit.theta, [*plant.theta, 1.0], rtol=1e-6)


@pytest.mark.parametrize(("name", "longest", "order"), [("second-order", 0.1, 4), ("non-minimum-phase", 0.025, 2)])
def test_matched_converges_with_the_second_power_of_the_period_or_the_fourth(name, longest, order):
    """The slope of the logarithm of the error is two for relative degree 1, and otherwise four. The periods are short
    enough that further terms do not change the third decimal."""
    plant = PLANTS[name]
    periods, errors = longest / np.array([1, 2, 4, 8]), []
    for dt in periods:
        u = np.repeat(prbs(400, clock=1, amplitude=1.0, rng=np.random.default_rng(1)), round(0.4 / dt))
        y = simulate_process(plant.b, plant.a, u, dt)
        model = TransferFunction(len(plant.a) - 1, len(plant.b) - 1)
        theta = LS(model, ENCODER, dt, plant.cutoff).fit_output(u, y).theta
        errors.append(np.max(np.abs(theta / plant.theta - 1)))
    slope = np.polyfit(np.log(periods), np.log(errors), 1)[0]
    assert round(slope, 3) >= 2, (slope, errors)
    assert slope == pytest.approx(order, abs=0.01)


def test_exact_with_noise_is_least_squares_still():
    """Noise causes the same bias as with the matched filters: the discretisation has little other effect."""
    plant = PLANTS["second-order"]
    y = plant.y + 0.3 * np.std(plant.y) * np.random.default_rng(5).standard_normal(plant.samples)
    matched, refined = (
        LS(TransferFunction(2, 0), ENCODER, plant.dt, plant.cutoff, discretization=kind).fit_output(plant.u, y)
        for kind in ("matched", "exact")
    )
    np.testing.assert_allclose(refined.theta, matched.theta, rtol=0.03)
    assert refined.theta_std == pytest.approx(matched.theta_std, rel=0.2)


def test_what_has_no_exact_filters_says_so():
    ls = LS(TransferFunction(2, 0, initial_conditions=True), ENCODER, 0.1, 2.0, discretization="exact")
    plant = PLANTS["non-minimum-phase"]
    refused(("does not allow the terms", lambda: ls.fit_output(plant.u, plant.y)))
