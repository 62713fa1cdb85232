"""If normal work differs from the simulation, the deviations of the reference record set the thresholds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.errors import UsageError
from pmfid.estimators.iv import IV
from pmfid.monitor.calibration import Calibration, calibrate, fit_tail, learn, noisier, piece_length, resample_units
from pmfid.monitor.detector import EDGE, statistics
from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.monitor.scores import Blocks, scores
from pmfid.pipeline.monitored.setup import cached_calibration, calibration_notes
from pmfid.simulation import (
    CART,
    CART_CONTROL,
    CART_DT,
    Machine,
    control_machine,
    make_scenario,
    resolution_of,
)
from studies.monitoring.axis import INCREMENTS, make_riv, random_stop_and_go
from studies.monitoring.false_alarms import HOLD, count_alarms

BLOCK = 0.2


def encoder_like(shape: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    """Return blocks of unit variance in which neighbours compensate each other."""
    white = rng.standard_normal((shape[0], shape[1] + 1, shape[2]))
    return (white[:, 1:] - 0.6 * white[:, :-1]) / np.sqrt(1.36)


@pytest.mark.parametrize("seed", range(8))
def test_deviations_that_add_up_are_noisier(seed: int) -> None:
    """Independent blocks of the same size, as of a white force: their sums grow, unlike the sums of an encoder's
    error.
    """
    rng = np.random.default_rng(seed)
    w = np.abs(rng.standard_normal((40, 3000, 3)))
    simulated = (np.sqrt(w) * encoder_like(w.shape, rng), w)
    record = w[0]
    assert not noisier((np.sqrt(record) * encoder_like((1, 3000, 3), rng)[0], record), simulated, EDGE)
    assert noisier((np.sqrt(record) * rng.standard_normal((3000, 3)), record), simulated, EDGE)


def test_pieces_of_a_record() -> None:
    """Pieces are runs of neighbours from any place; mean and size of each run have the errors of the record's."""
    rng = np.random.default_rng(0)
    x, w = rng.standard_normal((500, 2)), np.ones((500, 2))
    drawn, reported = resample_units(x, w, (400, 64), 4, rng)
    assert drawn.shape == reported.shape == (400, 64, 2)
    differences = np.diff(x[:, 0], append=x[:1, 0])
    found = np.diff(drawn[0, :4, 0])
    scale = [found / differences[(k + np.arange(3)) % 500] for k in range(500)]
    assert min(np.ptp(one) for one in scale) < 1e-9
    means = resample_units(x, w, (400, 5000), 1, rng)[0].mean(axis=1)
    assert np.std(means) == pytest.approx(math.hypot(500**-0.5, 5000**-0.5), rel=0.15)


@pytest.mark.parametrize(("memory", "length"), [(0.0, 1), (0.6, 4), (0.9, 16)])
def test_pieces_are_as_long_as_the_dependence(memory: float, length: int) -> None:
    x = autoregressive(np.random.default_rng(3), memory, 4000, 3)
    assert abs(math.log2(piece_length(x) / length)) <= 1


def autoregressive(rng: np.random.Generator, memory: float, n: int, p: int) -> Any:
    x = rng.standard_normal((n, p))
    for k in range(1, n):
        x[k] += memory * x[k - 1]
    return x * math.sqrt(1 - memory**2)


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
    found, simulated = calibrate(riv, theta, u, counts, hours=4.0), calibrate(riv, theta, u, None, hours=2.0)
    assert found.record_hours == pytest.approx(0.4, abs=0.01)
    work = normal(machine, 2, 2.0)
    assert alarms_of(found, found.deviations(scores(riv, theta, *work, found.left_out)[4:])) <= 5
    if name != "white force":
        assert alarms_of(simulated, simulated.deviations(scores(riv, theta, *work)[4:])) > 20


def alarms_of(calibration: Calibration, pair: Any) -> int:
    hold = round(HOLD * len(pair[0]) / 7200)
    x, w = (part[: len(part) // 24 * 24].reshape(24, -1, 3) for part in pair)
    return count_alarms(x, w, calibration.tail.threshold(1.0), hold)


@pytest.mark.parametrize("name", MACHINES)
def test_friction_that_grows_is_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All friction grows by a fifth: with much Coulomb friction this was once reported as a loss of force."""
    machine, riv = MACHINES[name], make_riv(INCREMENTS)
    u, counts = normal(machine, 1, 0.25)
    theta = IV(riv.model, riv.encoder, CART_DT, 50.0).fit(u, counts).theta
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path))
    made, *_ = cached_calibration(riv, theta, u, counts, 1.0)
    found, _, was_there = cached_calibration(riv, theta, u, counts, 1.0)
    assert was_there
    assert found.tail == made.tail
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
    found, plain = calibrate(riv, theta, u, counts, hours=2.0), calibrate(riv, theta, u, None, hours=2.0)
    assert found.record_hours == 0
    assert found.tail == plain.tail


def test_the_note_says_that_a_record_is_short() -> None:
    tail = fit_tail(np.random.default_rng(2).exponential(size=(4, 900)), BLOCK)
    scale: Any = None
    found = Calibration(np.ones(3), scale, tail, np.ones(3), 20.0)
    assert calibration_notes(found, 24.0) == []
    noisy = replace(found, noise=np.array([1.0, 2.0, 1.0]), record_hours=0.5)
    assert calibration_notes(noisy, 24.0)[0].startswith("normal work is 2 times as noisy as the encoder explains")
    assert len(calibration_notes(noisy, 24.0)) == 1
    unsure = replace(tail, parts=tuple((tail.level + k * tail.slope, tail.slope, tail.rate) for k in (-3, -1, 1, 3)))
    short = calibration_notes(replace(noisy, tail=unsure), 24.0)[1]
    assert "to a factor of 3.6" in short
    assert "about 1.7 h" in short
    assert unsure.threshold(24.0) == pytest.approx(tail.threshold(48.0))


# --- thresholds of known sequences ------------------------------------------------------------------------------------

SEQUENCES = {
    "independent": lambda rng, n: rng.standard_normal((n, 3)),
    "neighbours go together": lambda rng, n: autoregressive(rng, 0.5, n, 3),
    "heavy tails": lambda rng, n: rng.standard_t(4, size=(n, 3)),
}


@pytest.mark.parametrize("name", SEQUENCES)
@pytest.mark.long
def test_the_run_length_is_the_one_asked(name: str) -> None:
    """Blocks of known laws have the same information; thresholds from one hour give about the requested alarms in
    others.
    """
    rng, ratios = np.random.default_rng(7), []
    for _ in range(3):
        own = known_blocks(SEQUENCES[name](rng, 20_000))
        work = learn(own, np.ones(20_000))
        reference = work.scale.standardise(work.units(own, np.ones(20_000)))
        more = known_blocks(SEQUENCES[name](rng, 400_000))
        x, w = work.scale.standardise(work.units(more, np.ones(400_000)))
        drawn = resample_units(*reference, (256, 250), piece_length(reference[0]), rng)
        unit = 3600 / len(reference[0])
        tail = fit_tail(statistics(*drawn, np.zeros(3)), unit)
        alarms = count_alarms(x.reshape(20, -1, 3), w.reshape(20, -1, 3), tail.threshold(1.0), 4)
        ratios.append(20 / alarms)
    assert 0.5 <= np.exp(np.mean(np.log(ratios))) <= 2.0


def known_blocks(x: Any) -> Blocks:
    unit = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    return Blocks(x, unit, unit)


def test_a_short_record_with_a_change_gives_no_thresholds() -> None:
    """Units drawn from a few may all be the same one: the threshold was once not a number."""
    run = make_scenario("mass-step", seed=0)
    theta = np.array([1.25, 12.7, 0.86])
    estimator = make_riv(4096, theta)
    with pytest.raises(UsageError, match=r"need 32 .* it has 10 in 30 s: record 96 s"):
        calibrate(estimator, theta, run.motion.u, run.counts, hours=1.0)


def test_what_is_off_all_the_time_is_normal() -> None:
    """A mean that the model cannot explain is no change, and a few wild blocks hardly change the learned values."""
    rng = np.random.default_rng(5)
    x = rng.standard_normal((20_000, 3)) + 0.5
    calm = learn(known_blocks(x), np.ones(len(x)))
    assert calm.offset == pytest.approx(np.full(3, 0.5), abs=0.04)
    x[rng.integers(len(x), size=20)] += 200.0
    wild = learn(known_blocks(x), np.ones(len(x)))
    assert wild.offset == pytest.approx(np.full(3, 0.5), abs=0.06)
    assert wild.scale.sigma == pytest.approx(calm.scale.sigma, rel=0.1)
    units = wild.units(known_blocks(x), np.ones(len(x)))
    assert np.abs(wild.scale.standardise(units)[0]).max() <= wild.limit.max() * (1 + 1e-9)
