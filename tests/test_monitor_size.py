"""The size of an alarm and its bar: the bar contains the truth as often as it promises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid import RIV, Drive, Encoder
from pmfid.cli.monitor_lines import sentence
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.cause import ChangeEvidence, new_gain, start_of
from pmfid.monitor.events import Alarm, Change, Settled, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import Blocks, Scale, make_scale, scores
from pmfid.pipeline.monitored.run import event_object
from pmfid.simulation import CART, Schedule, quantize, simulate_drive
from pmfid.simulation.signals import prbs
from studies.monitoring.axis import changing, make_riv, normal_work

THETA = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
NAMES = ("mass", "viscous_friction", "coulomb_friction")
INCREMENTS, SEEDS = 512, 12


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    u, _ = normal_work(7, INCREMENTS, 0.05)
    return calibrate(make_riv(INCREMENTS), THETA, u, None, hours=2.0)


def first_alarm(calibration: Calibration, name: str, factor: float, seed: int) -> Alarm | None:
    when = 8.0 + 3.0 * np.random.default_rng((seed, 3)).random()
    after = replace(CART, **{name: factor * getattr(CART, name)})
    u, counts = changing(Schedule(((0.0, CART), (when, after))), seed, INCREMENTS, when + 6)
    monitor = Monitor(make_riv(INCREMENTS, THETA), calibration, Watch())
    for a, b in zip(u.tolist(), counts.tolist(), strict=True):
        for event in monitor.step(a, b)[1]:
            if isinstance(event, Alarm):
                return event
    return None


@pytest.mark.parametrize(("name", "factor"), [("mass", 1.35), ("mass", 0.75), ("viscous_friction", 1.2)])
def test_the_bar_contains_the_truth(calibration: Calibration, name: str, factor: float) -> None:
    """Half of the sizes were once off by more than two error bars, and some by more than 45."""
    truth = (factor - 1) * getattr(CART, name)
    alarms = [first_alarm(calibration, name, factor, seed) for seed in range(SEEDS)]
    reported = [alarm for alarm in alarms if alarm is not None and alarm.parameter == name]
    assert len(reported) >= SEEDS - 2
    z = np.array([(alarm.change - truth) / alarm.std for alarm in reported])
    assert np.mean(np.abs(z) < 2) >= 0.8
    assert np.max(np.abs(z)) < 4
    assert np.median([alarm.std for alarm in reported]) < 0.35 * abs(truth)


def changed(direction: np.ndarray, partly: float) -> tuple[Blocks, Scale]:
    """Return normal work whose blocks from 200 on show a change, the first of them only a part."""
    u, counts = normal_work(5, INCREMENTS, 0.02)
    blocks = scores(make_riv(INCREMENTS), THETA, u, counts)[6:]
    score = blocks.score.copy()
    score[200:] += blocks.cross[200:] @ direction
    score[200] -= (1 - partly) * blocks.cross[200] @ direction
    return Blocks(score, blocks.cross, blocks.square)[:210], make_scale(blocks)


def test_a_change_did_not_begin_after_it_was_noticed() -> None:
    direction = 0.1 * THETA * np.eye(3)[0]
    blocks, _ = changed(direction, 1.0)
    assert 199 <= start_of(blocks, direction, len(blocks.score) - 1) <= 203
    assert start_of(blocks, direction, 195) <= 195


def test_reversals_that_come_at_other_instants_are_no_part_of_the_change() -> None:
    """With much dry friction, a change of +20 % was once reported as +13 % with a bar of 0.6 %. The reversals were
    taken from the reference."""
    axis = replace(CART, mass=1.5, viscous_friction=6.0, coulomb_friction=0.5)
    theta, dt, when = np.array([1.5, 6.0, 0.5]), 0.01, 12.0
    drive, encoder = Drive(CART.input_gain), Encoder(2e-5)
    initial = dict(zip(NAMES, theta.tolist(), strict=True))
    estimator = RIV(drive, encoder, dt, 33.3, forgetting=0.995, initial=initial)
    u = [prbs(3000, clock=10, amplitude=1.0, rng=np.random.default_rng(seed)) for seed in range(4)]
    calibration = calibrate(estimator, theta, u[3], None, hours=1.0)
    for signal in u[:3]:
        plant = Schedule(((0.0, axis), (when, replace(axis, mass=1.8))))
        monitor, counts = Monitor(estimator, calibration, Watch()), quantize(simulate_drive(plant, signal, dt).x, 2e-5)
        alarms = [e for a, b in zip(signal, counts, strict=True) for e in monitor.step(a, b)[1] if isinstance(e, Alarm)]
        assert alarms[0].parameter == "mass"
        assert abs(alarms[0].change - 0.3) < 3 * alarms[0].std
        assert alarms[0].change == pytest.approx(0.3, rel=0.15)
        estimator.reset()


def test_after_a_weaker_motor_the_gain_leads_and_no_mass_has_grown() -> None:
    """The line and the page once reported a mass of +17.6 %, which did not exist."""
    gain = new_gain(ChangeEvidence(THETA / 0.85, np.diag((0.001 * THETA) ** 2)), THETA, Drive(2.0).equation)
    assert gain == pytest.approx((1.7, gain[1], 2.0))
    assert 0.0 < gain[1] < 0.002
    settled = event_object(Settled(1.0, THETA / 0.85, 0.001 * THETA, THETA, gain), NAMES)
    assert list(settled["parameters"]) == ["input_gain", *NAMES]
    changes = [found["change"] for found in settled["parameters"].values()]
    assert changes == pytest.approx([-0.15, 0.0, 0.0, 0.0], abs=1e-9)


def test_a_line_names_the_other_causes() -> None:
    mass = Change("mass", "kg", 0.2, 0.01, 0.2)
    alarm = Alarm(3.0, 2.0, (mass,), 30.0, 20.0, ("input_gain",), tolerance=0.02)
    said = sentence(event_object(alarm, NAMES))
    assert "since 2.00 s, or input gain; 10 times the tolerance of 2 %. Check whether the load" in said
    assert "others" not in event_object(replace(alarm, others=()), NAMES)
