"""Thresholds where normal work is not what the simulation knows: the reference record's own deviations count."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmfid.estimators.iv import IV
from pmfid.monitor.calibration import Calibration, block_keep, calibrate, fit_record_tail, fit_tail
from pmfid.monitor.detectors import EDGE, make_detectors
from pmfid.monitor.names import DETECTORS
from pmfid.monitor.reference import PIECE, noisier, resampled
from pmfid.monitor.scores import block_samples, scores
from pmfid.session.monitored.setup import calibration_notes
from pmfid.simulation import CART, CART_CONTROL, CART_DT, Machine, control_machine, resolution_of
from studies.monitoring.axis import INCREMENTS, make_riv, random_stop_and_go
from studies.monitoring.false_alarms import HOLD, count_alarms

BLOCK = 0.2


def encoder_like(shape: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    """Blocks of unit variance that balance their neighbours."""
    white = rng.standard_normal((shape[0], shape[1] + 1, shape[2]))
    return (white[:, 1:] - 0.6 * white[:, :-1]) / np.sqrt(1.36)


@pytest.mark.parametrize("seed", range(8))
def test_deviations_that_add_up_are_noisier(seed: int) -> None:
    """Blocks of the same size, but independent, as of a white force: their sums grow as an encoder's do not."""
    rng = np.random.default_rng(seed)
    w = np.abs(rng.standard_normal((40, 3000, 3)))
    simulated = (np.sqrt(w) * encoder_like(w.shape, rng), w)
    record = w[0]
    assert not noisier((np.sqrt(record) * encoder_like((1, 3000, 3), rng)[0], record), simulated, EDGE)
    assert noisier((np.sqrt(record) * rng.standard_normal((3000, 3)), record), simulated, EDGE)


def test_pieces_of_a_record() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(1.0, 301.0)[:, None] * [1.0, 2.0]
    drawn, w = resampled(x, np.abs(x), (50, 400), rng)
    assert drawn.shape == w.shape == (50, 400, 2)
    assert np.array_equal(np.abs(drawn), w)
    first = drawn[:, :PIECE, 0]
    assert set(np.abs(np.diff(first, axis=1)).ravel()) <= {1.0, 299.0}
    assert 10 < np.sum(first[:, 0] < 0) < 40


def test_a_short_record_makes_a_high_threshold() -> None:
    statistic = np.random.default_rng(1).exponential(size=(20, 9000))
    simulated = fit_tail(statistic, BLOCK)
    thresholds = [fit_record_tail(statistic, BLOCK, hours).threshold(24.0) for hours in (10.0, 1.0, 0.2)]
    assert simulated.threshold(24.0) < thresholds[0] < thresholds[1] < thresholds[2]
    assert thresholds[0] == pytest.approx(simulated.threshold(24.0), rel=0.3)


# --- machines that the model does not describe ------------------------------------------------------------------------


def normal(machine: Machine, seed: int, hours: float) -> tuple[Any, Any]:
    rng, resolution = np.random.default_rng((seed, 11)), resolution_of(INCREMENTS)
    reference = random_stop_and_go(round(hours * 3600 / CART_DT), rng)
    gains = {name: CART_CONTROL[name] for name in ("kp", "kd", "u_max")}
    phase = resolution * rng.random()
    run = control_machine(machine, reference, CART_DT, resolution, **gains, phase=phase, rng=rng, steps=3)
    return run.u, run.counts


MACHINES = {
    "white force": Machine(CART, force_noise=0.15),
    "Stribeck friction": Machine(CART, stribeck=0.2 * CART.coulomb_friction),
}


@pytest.mark.parametrize("name", MACHINES)
def test_false_alarms_of_another_machine(name: str) -> None:
    """One alarm an hour is asked; with the simulation's thresholds nearly every detector gave more than ten."""
    machine, riv, hours = MACHINES[name], make_riv(INCREMENTS), 1.0
    u, counts = normal(machine, 1, 0.3)
    theta = IV(riv.model, riv.encoder, CART_DT, 50.0).fit(u, counts).theta
    found = calibrate(riv, theta, u, counts, hours=2.0)
    assert found.record_hours == pytest.approx(0.3, abs=0.01)
    blocks = scores(riv, theta, *normal(machine, 2, hours))
    x, w = (part[: len(part) // 24 * 24].reshape(24, -1, 3) for part in found.scale.standardise(blocks))
    hold = round(HOLD / (block_samples(riv) * CART_DT))
    simulated = calibrate(riv, theta, u, None, hours=2.0)
    for kind, detector in make_detectors(block_keep(riv), found.chi_square).items():
        assert count_alarms(detector, x, w, found.tails[kind].threshold(1.0), hold) <= 4
        if kind != "glr" or name != "white force":
            old = make_detectors(block_keep(riv), simulated.chi_square)[kind]
            assert count_alarms(old, x, w, simulated.tails[kind].threshold(1.0), hold) > 10


def test_the_right_machine_keeps_its_thresholds() -> None:
    u, counts = normal(Machine(CART), 3, 0.2)
    riv, theta = make_riv(INCREMENTS), np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    found, plain = calibrate(riv, theta, u, counts, hours=2.0), calibrate(riv, theta, u, None, hours=2.0)
    assert found.record_hours == 0
    assert {name: found.tails[name] for name in DETECTORS} == plain.tails


def test_the_note_says_that_a_record_is_short() -> None:
    tails = dict.fromkeys(DETECTORS, fit_tail(np.random.default_rng(2).exponential(size=(4, 900)), BLOCK))
    scale: Any = None
    found = Calibration(np.ones(3), scale, (), tails, np.ones(3), 20.0)
    assert calibration_notes(found, 24.0) == []
    noisy = calibration_notes(replace(found, noise=np.array([1.0, 2.0, 1.0]), record_hours=0.5), 24.0)
    assert noisy[0].startswith("normal work is 2 times as noisy as the encoder explains")
    assert "has 0.5 h, too few to show what happens once in 24 h" in noisy[1]
    assert len(calibration_notes(replace(found, record_hours=30.0), 24.0)) == 1
