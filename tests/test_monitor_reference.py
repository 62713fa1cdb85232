"""If normal work differs from the simulation, the deviations of the reference record set the thresholds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmfid.estimators.iv import IV
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import scores
from pmfid.simulation import (
    CART,
    CART_CONTROL,
    CART_DT,
    Machine,
    control_machine,
    resolution_of,
)
from studies.monitoring.axis import INCREMENTS, make_riv, random_stop_and_go
from studies.monitoring.false_alarms import HOLD, count_alarms

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
@pytest.mark.long
def test_false_alarms_of_another_machine(name: str) -> None:
    """One alarm an hour is requested; with the simulation's threshold more than ten came."""
    machine, riv = MACHINES[name], make_riv(INCREMENTS)
    u, counts = normal(machine, 1, 0.4)
    theta = IV(riv.model, riv.encoder, CART_DT, 50.0).fit(u, counts).theta
    found, simulated = calibrate(riv, theta, u, counts), calibrate(riv, theta, u, None)
    assert found.record_hours == pytest.approx(0.4, abs=0.01)
    work = normal(machine, 2, 2.0)
    assert alarms_of(found, found.deviations(scores(riv, theta, *work, found.left_out)[4:])) <= 5
    if name != "white force":
        assert alarms_of(simulated, simulated.deviations(scores(riv, theta, *work)[4:])) > 20


def alarms_of(calibration: Calibration, pair: Any) -> int:
    hold = round(HOLD * len(pair[0]) / 7200)
    x, w = (part[: len(part) // 24 * 24].reshape(24, -1, 3) for part in pair)
    return count_alarms(x, w, calibration.chance.threshold(1.0), hold)


@pytest.mark.parametrize("name", MACHINES)
def test_friction_that_grows_is_named(name: str) -> None:
    """All friction grows by a fifth: with much Coulomb friction this was once reported as a loss of force."""
    machine, riv = MACHINES[name], make_riv(INCREMENTS)
    u, counts = normal(machine, 1, 0.25)
    theta = IV(riv.model, riv.encoder, CART_DT, 50.0).fit(u, counts).theta
    found = calibrate(riv, theta, u, counts)
    monitor = Monitor(make_riv(INCREMENTS, theta), found, Watch())
    worn = replace(
        machine,
        drive=replace(CART, viscous_friction=1.2 * CART.viscous_friction, coulomb_friction=1.2 * CART.coulomb_friction),
        stribeck=1.2 * machine.stribeck,
    )
    events = []
    for part in (normal(machine, 3, 0.01), normal(worn, 4, 0.02)):
        for value, count in zip(*(signal.tolist() for signal in part), strict=True):
            events += monitor.step(value, count)[1]
        events += monitor.skip(100)
    alarms = [event for event in events if isinstance(event, Alarm)]
    assert alarms[0].parameter in ("viscous_friction", "coulomb_friction", "friction")
    assert 36.0 < alarms[0].time < 90.0
    assert monitor.reference[1:] / theta[1:] == pytest.approx([1.2, 1.2], abs=0.06)


def test_the_right_machine_keeps_its_thresholds() -> None:
    u, counts = normal(Machine(CART), 3, 0.2)
    riv, theta = make_riv(INCREMENTS), np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    found, plain = calibrate(riv, theta, u, counts), calibrate(riv, theta, u, None)
    assert found.record_hours == 0
    assert found.chance.threshold(24.0) == pytest.approx(plain.chance.threshold(24.0), rel=0.05)
