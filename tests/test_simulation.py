"""The simulated plants against an ODE solver, the laws of mechanics and themselves, and simulated encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.simulation import (
    CART,
    CART_CONTROL,
    CART_RESOLUTION,
    SCENARIOS,
    DriveParameters,
    Faults,
    Schedule,
    make_scenario,
    mls,
    multisine,
    position_control,
    prbs,
    quantize,
    resolution_of,
    s_curve,
    simulate_drive,
    stop_and_go,
)
from pmfid.simulation._plant import read_encoder
from pmfid.simulation.drive import Machine, control_machine, drive_machine
from pmfid.types import Floats
from studies.exactness import agreement
from tests.refusals import refused


def step(p: DriveParameters, u: float, dt: float, x: float, v: float) -> tuple[float, float, float, float]:
    """Return x and v after one interval, with the direction and moving fractions of the interval."""
    motion = simulate_drive(p, [u, 0.0], dt, x, v)
    return float(motion.x[1]), float(motion.v[1]), float(motion.direction[0]), float(motion.moving[0])


def test_agrees_with_an_ode_solver_over_ten_seconds() -> None:
    found = agreement()
    assert found.duration == pytest.approx(10.0)
    assert found.reversals >= 20
    assert found.at_rest >= 50
    assert found.events >= 20
    assert found.position < 1e-8
    assert found.velocity < 1e-8


@pytest.mark.parametrize("viscous", [1e-300, 1e-14, 1e-7, 1e-3, 0.3, 0.9, 1.0, 1.1, 7.0, 400.0])
def test_no_digits_are_lost_for_small_friction_or_short_times(viscous: float) -> None:
    p = DriveParameters(mass=1.5, viscous_friction=viscous, coulomb_friction=0.5, input_gain=1.0)
    for dt in (1e-9, 1e-3, 0.75, 2.0):
        x, v, _, _ = step(p, 2.0, dt, 0.0, 0.25)
        with localcontext(prec=700):
            m, d, g, t, v0 = (Decimal(a) for a in (1.5, viscous, 1.5, dt, 0.25))
            decay = (-d / m * t).exp()
            exact_v = g / d + (v0 - g / d) * decay
            exact_x = g / d * t + (v0 - g / d) * m / d * (1 - decay)
            assert abs(Decimal(v) / exact_v - 1) < 2e-15
            assert abs(Decimal(x) / exact_x - 1) < 2e-15


@pytest.mark.parametrize("viscous", [1e-300, 1e-14, 1e-3, 0.9, 40.0])
def test_stop_time_and_place(viscous: float) -> None:
    p = DriveParameters(mass=1.5, viscous_friction=viscous, coulomb_friction=0.5, input_gain=1.0)
    x, v, direction, moving = step(p, 0.25, 9.0, 0.0, 0.4)
    with localcontext(prec=700):
        m, d, brake, v0 = (Decimal(a) for a in (1.5, viscous, 0.25, 0.4))
        time = m / d * (1 + d * v0 / brake).ln()
        place = m / d * (v0 - brake / d * (1 + d * v0 / brake).ln())
        assert abs(Decimal(moving) * 9 / time - 1) < 2e-15
        assert abs(Decimal(x) / place - 1) < 3e-15
    assert v == 0.0
    assert direction == moving


def test_stiction_holds_up_to_the_friction_force_and_no_further() -> None:
    p = DriveParameters(mass=1.0, viscous_friction=2.0, coulomb_friction=0.75, input_gain=0.5, offset=0.25)
    held = simulate_drive(p, [2.0, -1.0, 0.0, 0.5], 0.1, x0=0.3)
    assert (held.x == 0.3).all()
    assert not held.v.any()
    assert not held.moving.any()
    forward = simulate_drive(p, np.full(50, 2.0 + 1e-9), 0.1)
    assert (np.diff(forward.x) > 0.0).all()
    assert (forward.direction == 1.0).all()
    assert (forward.moving == 1.0).all()
    assert (simulate_drive(p, np.full(50, -1.0 - 1e-9), 0.1).direction == -1.0).all()


def test_quantize() -> None:
    x = np.array([-0.3, -0.25, 0.0, 0.24, 0.25, 1.1])
    assert quantize(x, 0.25).tolist() == [-2, -1, 0, 0, 1, 4]
    assert quantize(x, 0.25, phase=0.125).tolist() == [-1, -1, 0, 1, 1, 4]
    assert quantize(x, 0.25, bits=2).tolist() == [2, 3, 0, 0, 1, 0]
    assert quantize([-1.0, 0.0], 1.0, bits=63).tolist() == [2**63 - 1, 0]
    assert quantize(x, 0.25).dtype == np.int64


def control_by_hand(reference: Floats, kp: float, kd: float, u_max: float, phase: float) -> list[list[float]]:
    x, v, rows, before = 0.0, 0.0, [], None
    for target in reference.tolist():
        count = int(np.floor((x + phase) / 1e-3))
        y = 1e-3 * count
        u = kp * (target - y) - kd * (y - (y if before is None else before)) / 0.01
        u = max(-u_max, min(u_max, u))
        rows.append([x, v, u, count])
        before = y
        x, v, _, _ = step(CART, u, 0.01, x, v)
    return rows


def test_position_control_is_the_stated_law_bit_for_bit() -> None:
    reference = stop_and_go(300, 0.01, 0.2, 0.5, 0.3)
    gains = {"kp": 200.0, "kd": 5.0, "u_max": 3.0, "phase": 1.4e-3}
    motion, counts = position_control(CART, reference, 0.01, resolution=1e-3, **gains)
    rows = np.column_stack((motion.x, motion.v, motion.u, counts))
    np.testing.assert_array_equal(rows, control_by_hand(reference, **gains))
    assert np.abs(motion.u).max() == 3.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_tell_the_truth(name: str) -> None:
    scenario = make_scenario(name, seed=1, increments=512, duration=6.0)
    assert scenario.resolution == resolution_of(512) == CART_RESOLUTION * 8.0
    assert scenario.motion.t.size == scenario.counts.size == 600
    error = scenario.resolution * scenario.counts - scenario.motion.x
    assert np.ptp(error) < scenario.resolution
    again = simulate_drive(scenario.schedule, scenario.motion.u, scenario.dt)
    np.testing.assert_array_equal(again.x, scenario.motion.x)
    masses = scenario.schedule.sample(np.array([1.99, 2.99, 3.0, 4.0]), 0.01)[0]
    expected = {"mass-step": [1.07, 1.07, 1.44, 1.44], "mass-ramp": [1.07, 1.25315, 1.255, 1.44]}
    change = SCENARIOS[name].change
    np.testing.assert_allclose(masses, expected.get(change, [1.07] * 4), rtol=1e-6)


def test_multisine_has_its_lines_and_its_amplitude() -> None:
    u = multisine(1000, 0.01, [0.5, 3.0, 7.0], 3.0, np.random.default_rng(1))
    assert np.abs(u).max() == pytest.approx(3.0, rel=1e-12)
    lines = np.abs(np.fft.rfft(u))
    present = np.flatnonzero(lines > 1e-9 * lines.max())
    assert present.tolist() == [5, 30, 70]
    assert np.ptp(lines[present]) < 1e-9 * lines.max()


CONTROL: dict[str, Any] = {"kp": 1.0, "kd": 0.0, "u_max": 1.0, "resolution": 1e-3}
RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: replace(CART, mass=0.0), r"mass must be finite and > 0, got 0.0; give the moving mass"),
        (lambda: replace(CART, viscous_friction=-1.0), "viscous_friction .* got -1.0; .* 0 is none"),
        (lambda: replace(CART, coulomb_friction=float("nan")), "coulomb_friction .* got nan; "),
        (lambda: replace(CART, input_gain=float("inf")), "input_gain .* got inf; give .* N/V"),
        (lambda: simulate_drive(CART, [1.0], 0.0), "dt .* got 0.0; give the sample period"),
        (lambda: simulate_drive(CART, [], 0.1), r"u must have shape \(n,\).* one value per sample"),
        (lambda: simulate_drive(CART, [[1.0]], 0.1), r"u must have shape .* got \(1, 1\)"),
        (lambda: simulate_drive(CART, [1.0, np.nan], 0.1), r"u\[1\] is nan.*repair"),
        (lambda: simulate_drive(CART, [1e308] * 3, 0.1), "range of floating point; check the units"),
        (lambda: simulate_drive(CART, [1.0], 0.1, v0=np.inf), "v0 .* got inf; give the start velocity"),
        (lambda: Schedule(()), r"start at time 0, got \[\]; begin with"),
        (lambda: Schedule(((1.0, CART),)), r"start at time 0, got \[1.0\]; begin with"),
        (lambda: Schedule(((0.0, CART), (0.0, CART))), "time must .* > 0, got 0.0; sort the changes"),
        (lambda: quantize([0.0], 0.0), "resolution .* got 0.0; give the travel per count"),
        (lambda: quantize([np.nan], 1.0), r"within 2\*\*53 counts.* check the units"),
        (lambda: quantize([1e300], 1e-300), r"within 2\*\*53 counts.* check the units"),
        (lambda: quantize([1.0], 1.0, bits=64), r"bits .* in \[1, 63\], got 64; give the width"),
        (lambda: prbs(0, clock=1, amplitude=1.0, rng=RNG), "samples .* got 0; give the length"),
        (lambda: prbs(9, clock=0, amplitude=1.0, rng=RNG), "clock .* got 0; give the number"),
        (lambda: prbs(9, clock=1, amplitude=-1.0, rng=RNG), "amplitude .* got -1.0; give the largest"),
        (lambda: mls(1, 1, 1.0), r"stages .* \[2, 24\], got 1; the period is"),
        (lambda: multisine(9, 0.1, [5.0], 1.0, RNG), r"\(0, 5\) Hz.* got 5; leave it out"),
        (lambda: s_curve(9, 0.1, 0.2, 0.0), "move_time .* got 0.0; give the time"),
        (lambda: stop_and_go(9, 0.1, 0.2, 1.0, -0.1), "dwell_time .* got -0.1; give the pause"),
        (lambda: position_control(CART, [1.0], 0.1, **{**CONTROL, "kp": -1.0}), "kp .* got -1.0; for a reversed"),
        (lambda: position_control(CART, [1.0], 0.1, **{**CONTROL, "u_max": 0.0}), "u_max .* got 0.0; give"),
        (
            lambda: position_control(CART, [1.0], 0.1, **{**CONTROL, "resolution": 1e-300}, phase=1.0),
            r"beyond 2\*\*53 counts.*larger resolution",
        ),
        (lambda: make_scenario("nothing"), "unknown scenario 'nothing'; choose one of: prbs, mass-step"),
        (lambda: make_scenario("prbs", seed=-1), "seed .* got -1; give any whole number"),
        (lambda: make_scenario("prbs", duration=0.0), "duration .* got 0.0; give the length"),
        (lambda: resolution_of(0), "increments .* got 0; give the counts per turn"),
    ],
)
def test_bad_arguments_name_the_remedy(call: Callable[[], object], message: str) -> None:
    refused((message, lambda: call()), kind=ValueError)


DT = 0.01
HEAVY = DriveParameters(mass=220.0, viscous_friction=900.0, coulomb_friction=60.0, input_gain=35.0, offset=-3.0)


@pytest.mark.parametrize("drive", [CART, HEAVY])
def test_a_machine_that_lacks_nothing_moves_as_the_exact_drive(drive):
    u = prbs(3000, clock=10, amplitude=3.0, rng=np.random.default_rng(3))
    from pmfid.simulation import simulate_drive

    exact = simulate_drive(drive, u, DT)
    run = drive_machine(Machine(drive), u, DT, 1e-6)
    assert np.max(np.abs(run.x - exact.x)) < 1e-4 * np.ptp(exact.x)


def test_position_control_is_that_of_the_exact_drive_until_rounding_moves_an_edge():
    reference = stop_and_go(1000, DT, stroke=0.2, move_time=0.8, dwell_time=0.5)
    motion, counts = position_control(CART, reference, DT, **CART_CONTROL, resolution=1e-6, phase=0.0)
    run = control_machine(Machine(CART), reference, DT, 1e-6, **CART_CONTROL)
    assert np.max(np.abs(run.x - motion.x)) < 2e-4 * np.ptp(motion.x)
    assert np.array_equal(run.counts[:50], counts[:50])


def test_a_dead_time_shifts_the_motion():
    u = np.repeat(np.array([0.0, 2.0, -1.0, 3.0]), 100)
    plain = drive_machine(Machine(CART), u, DT, 1e-6)
    late = drive_machine(Machine(CART, dead_time=3 * DT), u, DT, 1e-6)
    assert np.array_equal(late.x[3:], plain.x[:-3])
    half = drive_machine(Machine(CART, dead_time=0.5 * DT), u, DT, 1e-6)
    finer = drive_machine(Machine(CART, dead_time=0.5 * DT), np.repeat(u, 2), DT / 2, 1e-6)
    assert np.allclose(half.x, finer.x[::2], atol=1e-6 * np.ptp(half.x))


def steady_speed(machine: Machine, force: float) -> float:
    run = drive_machine(machine, np.full(4000, force / machine.drive.input_gain), DT, 1e-6)
    return abs(float(run.v[-1]))


def test_each_friction_balances_the_force_at_constant_speed():
    for machine, extra in (
        (Machine(CART, quadratic=30.0), lambda v: 30.0 * v * v),
        (Machine(CART, stribeck=0.5, stribeck_speed=0.2), lambda v: 0.5 * np.exp(-((v / 0.2) ** 2))),
    ):
        v = steady_speed(machine, 5.0)
        assert CART.viscous_friction * v + CART.coulomb_friction + extra(v) == pytest.approx(5.0, rel=1e-9)
    uneven = Machine(CART, asymmetry=0.2)
    for force, side in ((5.0, 1.2), (-5.0, 0.8)):
        v = steady_speed(uneven, force)
        assert side * (CART.viscous_friction * v + CART.coulomb_friction) == pytest.approx(5.0, rel=1e-9)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50), st.floats(1e-3, 10.0), st.floats(0.0, 1.0))
@settings(max_examples=200)
def test_without_faults_it_is_the_floor(x: list[float], resolution: float, phase: float) -> None:
    places = np.zeros(3)
    read = read_encoder(np.array(x), resolution, phase, places, np.zeros(0), 0.0, 5)
    np.testing.assert_array_equal(read, quantize(x, resolution, phase))


def test_jitter_moves_the_edges_by_its_standard_deviation() -> None:
    x = np.full(40_000, 0.25)
    counts = quantize(x, 1.0, faults=Faults(jitter=0.5, seed=3))
    below = np.mean(counts < 0)  # probability that a normal variable is below -0.5 standard deviations
    assert below == pytest.approx(0.3085, abs=0.01)
    assert quantize(x, 1.0, faults=Faults(jitter=0.01)).tolist() == [0] * x.size


def test_the_controller_sees_the_faults_and_counts_on_past_the_wrap() -> None:
    reference = stop_and_go(600, 0.01, 0.2, 0.8, 0.5)
    lattice = {"resolution": 1.82e-4, "phase": 1e-5}
    faults = Faults(missed=0.01, jitter=0.1, line_error=0.3, lines=512, seed=4)
    whole, counts = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice, faults=faults)
    again, narrow = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice, faults=faults, bits=8)
    np.testing.assert_array_equal(whole.x, again.x)
    np.testing.assert_array_equal(narrow, counts % 256)
    assert counts.max() > 512
    np.testing.assert_array_equal(counts, quantize(whole.x, **lattice, faults=faults))
    good, _ = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice)
    # missed edges make the cart go further than commanded
    assert whole.x[125] > good.x[125] + 5 * lattice["resolution"]
