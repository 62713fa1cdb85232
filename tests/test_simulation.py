"""The simulated drive against an ODE solver, 50-digit arithmetic, the laws of mechanics and itself."""

import doctest
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal, localcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pmfid.simulation.drive as drive_module
from pmfid.simulation import (
    CART,
    CART_RESOLUTION,
    SCENARIOS,
    DriveParameters,
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
    trapezoid,
    write_csv,
)
from pmfid.types import Floats
from studies.exactness import agreement
from tests.refusals import refused


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Return floats on a grid: the laws below need not hold where a product underflows."""
    return st.floats(low, high).map(lambda value: round(value, 9))


drives = st.builds(
    DriveParameters,
    mass=numbers(0.2, 20.0),
    viscous_friction=st.just(0.0) | numbers(1e-9, 10.0),
    coulomb_friction=st.just(0.0) | numbers(0.01, 3.0),
    input_gain=numbers(-5.0, 5.0),
    offset=numbers(-1.0, 1.0),
)
speeds = st.just(0.0) | numbers(-2.0, 2.0)


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


@given(drives, st.floats(-3.0, 3.0), speeds, st.floats(0.01, 0.99))
@settings(max_examples=300)
def test_an_interval_may_be_split(p: DriveParameters, u: float, v0: float, share: float) -> None:
    whole = step(p, u, 0.3, 0.1, v0)
    half = step(p, u, 0.3 * share, 0.1, v0)
    rest = step(p, u, 0.3 - 0.3 * share, half[0], half[1])
    assert rest[:2] == pytest.approx(whole[:2], rel=1e-12, abs=1e-12)
    for i in (2, 3):
        assert share * half[i] + (1.0 - share) * rest[i] == pytest.approx(whole[i], abs=1e-11)


def test_coasting_without_friction_and_with_next_to_no_brake() -> None:
    free = DriveParameters(mass=2.0, viscous_friction=0.0, coulomb_friction=0.0, input_gain=1.0)
    assert step(free, 0.0, 0.5, 1.0, -3.0) == (-0.5, -3.0, -1.0, 1.0)
    damped = replace(free, viscous_friction=2.0)
    for force in (0.0, -1e-310):  # the time to stop overflows
        expected = (1.0 - np.exp(-0.5), np.exp(-0.5), 1.0, 1.0)
        assert step(damped, force, 0.5, 0.0, 1.0) == pytest.approx(expected, rel=1e-14)


@given(drives.filter(lambda p: p.coulomb_friction > 0.0), st.floats(0.01, 2.0))
@settings(max_examples=200)
def test_a_stop_at_the_end_of_the_interval_leaves_no_velocity_of_the_other_sign(p: DriveParameters, v0: float) -> None:
    p = replace(p, offset=0.0)
    moving = step(p, 0.0, 1e4, 0.0, v0)[3]
    for dt in (1e4 * moving, np.nextafter(1e4 * moving, 0.0), 1e4 * moving * (1.0 - 4e-16)):
        assert 0.0 <= step(p, 0.0, dt, 0.0, v0)[1] <= 1e-12


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


def test_schedule_continues_the_state() -> None:
    heavy = replace(CART, mass=1.44)
    u = prbs(200, clock=7, amplitude=3.0, rng=np.random.default_rng(2))
    first = simulate_drive(CART, u[:31], 0.03)
    second = simulate_drive(heavy, u[30:], 0.03, first.x[30], first.v[30])
    for time in (0.9, 0.88):  # 30 * 0.03 < 0.9 in floating point; 0.88 lies between two samples
        whole = simulate_drive([(0.0, CART), (time, heavy)], u, 0.03)
        np.testing.assert_array_equal(whole.x, np.append(first.x[:30], second.x))


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
def test_same_seed_same_bytes(name: str, tmp_path: Path) -> None:
    for file, seed in (("a", 3), ("b", 3), ("c", 4)):
        write_csv(make_scenario(name, seed=seed, duration=4.0), tmp_path / file)
    first, second, other = ((tmp_path / file).read_bytes() for file in "abc")
    assert first == second
    assert first != other
    scenario = make_scenario(name, seed=3, duration=4.0)
    lines = first.decode().splitlines()
    assert lines[0] == "t,u,counts"
    assert [float(line.split(",")[1]) for line in lines[1:]] == scenario.motion.u.tolist()
    assert [int(line.split(",")[2]) for line in lines[1:]] == scenario.counts.tolist()


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


def test_prbs_and_mls() -> None:
    u = prbs(4001, clock=4, amplitude=2.5, rng=np.random.default_rng(0))
    assert u.shape == (4001,)
    assert set(np.abs(u)) == {2.5}
    assert (u[:4000].reshape(-1, 4) == u[:4000:4, None]).all()
    assert abs(u.mean()) < 0.25
    period = mls(7, 3, 2.0)
    assert period.shape == (127 * 3,)
    bits = period[::3] / 2.0
    assert (np.repeat(2.0 * bits, 3) == period).all()
    assert [float(bits @ np.roll(bits, k)) for k in range(127)] == [127.0] + [-1.0] * 126


def test_multisine_has_its_lines_and_its_amplitude() -> None:
    u = multisine(1000, 0.01, [0.5, 3.0, 7.0], 3.0, np.random.default_rng(1))
    assert np.abs(u).max() == pytest.approx(3.0, rel=1e-12)
    lines = np.abs(np.fft.rfft(u))
    present = np.flatnonzero(lines > 1e-9 * lines.max())
    assert present.tolist() == [5, 30, 70]
    assert np.ptp(lines[present]) < 1e-9 * lines.max()


@pytest.mark.parametrize(("profile", "peak"), [(trapezoid, 1.5), (s_curve, 1.875)])
def test_profiles_go_from_rest_to_rest(profile: Callable[..., Floats], peak: float) -> None:
    x = profile(3001, 0.001, -0.4, 2.0)
    assert x[0] == 0.0
    np.testing.assert_allclose(x[2000:], -0.4, rtol=1e-12)
    v = np.diff(x) / 0.001
    assert (v <= 1e-12).all()
    assert np.abs(v).max() == pytest.approx(peak * 0.2, rel=1e-5)
    assert np.abs(np.diff(v)).max() < 1.5e-3 * peak  # no jump of the velocity
    assert abs(v[0]) < 1e-3


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


def test_examples_in_the_docstrings() -> None:
    result = doctest.testmod(drive_module)
    assert result.attempted > 0
    assert result.failed == 0
