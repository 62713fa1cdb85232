"""Block scores, detectors, thresholds and the monitor, against oracles and against the cart's true behaviour."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmfid import BCRLS, IV, RIV, RLS, Drive, Encoder, Status
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.chance import Chance
from pmfid.monitor.events import CANNOT_TELL, SETTLING, WATCHING, Alarm, Settled, StateChange, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import scores
from pmfid.simulation import CART, CART_DT, Schedule, prbs, quantize, resolution_of, simulate_drive
from studies.monitoring.axis import changing, drive, make_riv, normal_work, random_stop_and_go
from studies.monitoring.false_alarms import count_alarms, poisson_interval
from tests.conftest import TRUTH
from tests.refusals import refused

INCREMENTS = 1024


def front(increments: int = INCREMENTS) -> IV:
    return IV(Drive(CART.input_gain), Encoder(resolution_of(increments)), CART_DT, 50.0)


# --- scores -----------------------------------------------------------------------------------------------------------


def test_scores_are_the_information_times_the_deviation() -> None:
    """Without noise E S = W (theta - theta0), apart from the effect of the model's own stops."""
    u, counts = normal_work(1, 100_000, 0.05)
    away = TRUTH * [1.002, 1.0, 1.0]
    blocks = scores(front(100_000), away, u, counts)[5:]
    found = np.linalg.solve(blocks.cross.sum(axis=0), blocks.score.sum(axis=0))
    assert np.abs(found - (TRUTH - away)) / TRUTH == pytest.approx(np.zeros(3), abs=1e-3)
    assert found[0] == pytest.approx(-0.002 * CART.mass, rel=0.1)


# --- the detector -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [1e-3, 1e-4])
def test_the_threshold_follows_from_the_formula(rate: float) -> None:
    """The formula gives the rate of false alarms of independent normal units with equal information."""
    lengths = (1, 2, 4, 8, 16, 32)
    ones = np.ones((len(lengths), 3))
    chance = Chance(3600.0, lengths, ones, 0.0 * ones, np.array(lengths)[:, None, None] * ones[:, None])
    threshold = chance.threshold(1 / rate)
    assert chance.rate(threshold) == pytest.approx(rate, rel=1e-4)
    x = np.random.default_rng(1).standard_normal((100, round(2 / rate), 3))
    alarms = count_alarms(x, np.ones_like(x), threshold, 40)
    assert alarms == pytest.approx(x[..., 0].size * rate, rel=0.25)


@pytest.mark.long
def test_alarms_are_as_rare_as_asked() -> None:
    """This is a small form of the study: one false alarm in a quarter of an hour, over nine hours under control."""
    u, counts = normal_work(7, INCREMENTS, 0.5)
    riv = make_riv(INCREMENTS)
    found = calibrate(riv, TRUTH, u, counts)
    pairs = [found.scale.standardise(scores(riv, TRUTH, *normal_work(seed, INCREMENTS, 0.5))) for seed in range(30, 48)]
    x, w = np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])
    assert 18 <= count_alarms(x, w, found.chance.threshold(0.25), 88) <= 72
    low, high = poisson_interval(36, 9.0)
    assert low < 0.25 < high


# --- opening the memory -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", [RLS, BCRLS, RIV])
@pytest.mark.parametrize("parameter", [None, "mass"])
def test_opening_keeps_the_estimate_and_lets_go_of_the_past(cls: Any, parameter: str | None) -> None:
    loaded = Schedule(((0.0, CART), (10.0, replace(CART, mass=1.44))))
    u, counts = changing(loaded, 3, 4096, 16.0)
    estimator = cls(Drive(2.0), Encoder(resolution_of(4096)), CART_DT, 50.0, forgetting=0.99)
    estimator.run(u[:1040], counts[:1040])
    before = estimator.estimate
    estimator.open_memory(0.02 if parameter is None else 0.001, parameter)
    assert np.array_equal(estimator.estimate.theta, before.theta)
    opened = estimator.run(u[1040:1150], counts[1040:1150])["mass"][-1]
    estimator.reset()
    closed = estimator.run(u[:1150], counts[:1150])["mass"][-1]
    assert abs(opened / 1.44 - 1) < 0.3 * abs(closed / 1.44 - 1)


def test_opening_one_parameter_leaves_the_others() -> None:
    """R - (1 - keep) r r^T / R_ii keeps the information on the other parameters."""
    u, counts = normal_work(4, INCREMENTS, 0.01)
    estimator = make_riv(INCREMENTS, TRUTH)
    estimator.run(u[:-4], counts[:-4])
    closed = estimator.get_state()
    estimator.open_memory(1.0)  # without the correction of the error bars by the blocks
    estimator.run(u[-4:], counts[-4:])
    before = np.linalg.inv(estimator.estimate.theta_cov / estimator.estimate.innovation_variance)
    estimator.set_state(closed)
    estimator.open_memory(0.01, "mass")
    estimator.run(u[-4:], counts[-4:])
    after = np.linalg.inv(estimator.estimate.theta_cov / estimator.estimate.innovation_variance)
    assert estimator.estimate.theta == pytest.approx(TRUTH, rel=0.05)
    assert after[0, 0] < 0.05 * before[0, 0]
    schur = [R[1:, 1:] - np.outer(R[1:, 0], R[0, 1:]) / R[0, 0] for R in (before, after)]
    assert schur[1] == pytest.approx(schur[0], rel=0.1)


def test_what_cannot_be_opened_is_said() -> None:
    estimator = make_riv(INCREMENTS)
    refused(
        (r"keep must be in \(0, 1\], got 0", lambda: estimator.open_memory(0.0)),
        ("parameter must be one of", lambda: estimator.open_memory(0.5, "inertia")),
    )
    estimator.open_memory(0.5)  # before the first sample the memory is empty
    assert estimator.estimate.status == 0


# --- the monitor ------------------------------------------------------------------------------------------------------


def run(calibration: Calibration, schedule: Any, watch: Watch, seconds: float = 30.0, seed: int = 1) -> list[Any]:
    u, counts = changing(schedule, seed, INCREMENTS, seconds)
    monitor = Monitor(make_riv(INCREMENTS, TRUTH), calibration, watch)
    return [event for a, b in zip(u.tolist(), counts.tolist(), strict=True) for event in monitor.step(a, b)[1]]


def test_a_mass_step_is_reported_once(calibration: Calibration) -> None:
    step = Schedule(((0.0, CART), (12.0, replace(CART, mass=1.1 * CART.mass))))
    events = run(calibration, step, Watch(), 34.0)
    (alarm,) = [event for event in events if isinstance(event, Alarm)]
    (settled,) = [event for event in events if isinstance(event, Settled)]
    assert 12.0 < alarm.time < 16.5  # until a second change is excluded
    assert abs(alarm.changed_at - 12.0) < 1.5
    assert (alarm.parameter, alarm.unit) == ("mass", "kg")
    assert alarm.relative == pytest.approx(0.1, abs=0.03)
    assert settled.theta / settled.before == pytest.approx([1.1, 1.0, 1.0], abs=0.015)


@pytest.mark.parametrize(("name", "total"), [("mass", 0.12), ("coulomb_friction", -0.15)])
def test_a_slow_change_is_one_alarm_with_a_rate(calibration: Calibration, name: str, total: float) -> None:
    """A step after it is another alarm."""
    value, seconds = getattr(CART, name), 450.0
    times = [20.0 + seconds * k / 100 for k in range(1, 101)]
    slow = [(at, replace(CART, **{name: value * (1 + total * k / 100)})) for k, at in enumerate(times, 1)]
    step = 550.0, replace(CART, **{name: value * (1 + 2 * total)})
    events = run(calibration, Schedule(((0.0, CART), *slow, step)), Watch(), 640.0)
    alarms = [event for event in events if isinstance(event, Alarm)]
    assert [(one.parameter, one.change > 0, one.time > 550.0) for one in alarms] == [
        (name, total > 0, False),
        (name, total > 0, True),
    ]
    rates = [event.rate for event in events if isinstance(event, Settled) and event.rate is not None]
    assert len(rates) >= 2
    assert np.median(rates) == pytest.approx(3600 * total / seconds, rel=0.3)


def test_within_the_tolerance_there_is_no_alarm(calibration: Calibration) -> None:
    small = Schedule(((0.0, CART), (10.0, replace(CART, mass=1.03 * CART.mass))))
    assert not [e for e in run(calibration, small, Watch(tolerance=0.05)) if isinstance(e, Alarm)]
    assert [e for e in run(calibration, small, Watch(tolerance=0.01)) if isinstance(e, Alarm)]


def test_at_standstill_it_cannot_tell(calibration: Calibration) -> None:
    rng = np.random.default_rng(6)
    moving = random_stop_and_go(2000, rng)
    u, counts = drive(CART, np.concatenate([moving, np.full(6000, moving[-1])]), INCREMENTS, rng)
    monitor = Monitor(make_riv(INCREMENTS, TRUTH), calibration, Watch(tolerance=0.0))
    events = []
    for a, b in zip(u.tolist(), counts.tolist(), strict=True):
        estimate, now = monitor.step(a, b)
        events += now
    assert [event.state for event in events if isinstance(event, StateChange)][-2:] == [WATCHING, CANNOT_TELL]
    assert not [event for event in events if isinstance(event, Alarm)]
    assert estimate.status & Status.STANDSTILL
    assert estimate.theta == pytest.approx(TRUTH, rel=0.02)


def test_lost_samples_are_no_change(calibration: Calibration) -> None:
    u, counts = normal_work(9, INCREMENTS, 40 / 3600)
    monitor = Monitor(make_riv(INCREMENTS, TRUTH), calibration, Watch())
    events, k = [], 0
    while k < u.size:
        if k % 500 == 300:
            events += monitor.skip(100)
            k += 100
        events += monitor.step(float(u[k]), int(counts[k]))[1]
        k += 1
    assert monitor.samples == k
    assert not [event for event in events if isinstance(event, Alarm)]
    assert monitor.state == WATCHING
    assert SETTLING not in [getattr(event, "state", "") for event in events]


@pytest.mark.parametrize("seed", range(2))
def test_a_change_of_mass_is_reported_at_1_volt_after_ten_seconds_at_12(calibration: Calibration, seed: int) -> None:
    """The mass changes two memories after the input has become small."""
    start, change = 1000, 1200
    estimator = make_riv(INCREMENTS, TRUTH)
    assert (change - start) * (1 - estimator.forgetting) == pytest.approx(2.0)
    u = prbs(change + 3000, clock=10, amplitude=1.0, rng=np.random.default_rng(seed))
    u[:start] *= 12.0
    loaded = Schedule(((0.0, CART), (change * CART_DT, replace(CART, mass=1.40))))
    counts = quantize(simulate_drive(loaded, u, CART_DT).x, resolution_of(INCREMENTS))
    monitor = Monitor(estimator, calibration, Watch())
    alarms: list[Alarm] = []
    for value, count in zip(u.tolist(), counts.tolist(), strict=True):
        alarms += [event for event in monitor.step(value, count)[1] if isinstance(event, Alarm)]
    assert [alarm.parameter for alarm in alarms] == ["mass"]
    assert 0.0 < alarms[0].time - change * CART_DT < 2.0
    assert 0.1 < (alarms[0].relative or 0.0) < 0.4
