"""The simulation of machines that the drive's equation does not describe."""

import numpy as np
import pytest

from pmfid.simulation import CART, CART_CONTROL, DriveParameters, position_control, prbs, stop_and_go
from pmfid.simulation.drive import Machine, control_machine, drive_machine
from tests.refusals import refused

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


def test_it_sticks_below_the_friction_at_rest_and_not_above():
    machine = Machine(CART, stribeck=0.4)
    volts = (CART.coulomb_friction + 0.4) / CART.input_gain
    assert np.ptp(drive_machine(machine, np.full(100, 0.99 * volts), DT, 1e-6).x) == 0.0
    assert np.ptp(drive_machine(machine, np.full(100, 1.01 * volts), DT, 1e-6).x) > 0.0


def test_values_out_of_range_are_refused():
    noisy, fields = Machine(CART, force_noise=0.3), ("stribeck", "quadratic", "stiffness", "dead_time", "force_noise")
    refused(
        *((f, lambda f=f, x=x: Machine(CART, **{f: x})) for f in fields for x in (-1.0, np.nan, np.inf)),
        ("asymmetry", lambda: Machine(CART, asymmetry=1.0)),
        ("rng", lambda: drive_machine(noisy, np.full(100, 2.0), DT, 1e-6)),
        kind=ValueError,
    )
