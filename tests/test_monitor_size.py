"""The size of an alarm and its bar: the bar contains the truth as often as it promises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.cause import start_of
from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import Blocks, Scale, make_scale, scores
from pmfid.simulation import CART, Schedule
from studies.monitoring.axis import changing, make_riv, normal_work
from tests.conftest import TRUTH

INCREMENTS, SEEDS = 512, 12


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    u, _ = normal_work(7, INCREMENTS, 0.05)
    return calibrate(make_riv(INCREMENTS), TRUTH, u, None)


def first_alarm(calibration: Calibration, name: str, factor: float, seed: int) -> Alarm | None:
    when = 8.0 + 3.0 * np.random.default_rng((seed, 3)).random()
    after = replace(CART, **{name: factor * getattr(CART, name)})
    u, counts = changing(Schedule(((0.0, CART), (when, after))), seed, INCREMENTS, when + 6)
    monitor = Monitor(make_riv(INCREMENTS, TRUTH), calibration, Watch())
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
    blocks = scores(make_riv(INCREMENTS), TRUTH, u, counts)[6:]
    score = blocks.score.copy()
    score[200:] += blocks.cross[200:] @ direction
    score[200] -= (1 - partly) * blocks.cross[200] @ direction
    return Blocks(score, blocks.cross, blocks.square)[:210], make_scale(blocks)


def test_a_change_did_not_begin_after_it_was_noticed() -> None:
    direction = 0.1 * TRUTH * np.eye(3)[0]
    blocks, _ = changed(direction, 1.0)
    assert 199 <= start_of(blocks, direction, len(blocks.score) - 1) <= 203
    assert start_of(blocks, direction, 195) <= 195
