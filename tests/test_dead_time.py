"""An input that acts late, by any part of a sample: known, estimated, and found by a model without a dead time."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest

import pmfid
from pmfid import IV, RIV, Drive, Encoder, Fleet, MotionFit, Status
from pmfid.models.equation import Equation, Term
from pmfid.simulation.drive import DriveParameters, Machine, MachineRun, control_machine, drive_machine
from tests.conftest import long_unless
from tests.refusals import refused

#: Gain, mass, viscous and Coulomb friction, sample period, input, travel per count, cutoff.
CART = (2.0, 1.07, 12.8, 0.8, 0.01, 3.0, 9.2e-5, 20.0)
WHEEL = (0.031, 2.6e-5, 4e-5, 1.5e-3, 0.002, 0.4, 2 * np.pi / 2048, 40.0)
STAGE = (58.0, 41.0, 120.0, 16.0, 0.005, 1.6, 1e-5, 15.0)
AXES = {"cart": CART, "wheel": WHEEL, "stage": STAGE}


@cache
def prbs(axis: str, late: float, seed: int = 1, switches: int = 300) -> MachineRun:
    gain, mass, viscous, coulomb, dt, size, step, _ = AXES[axis]
    rng = np.random.default_rng(seed)
    u = size * np.repeat(rng.choice([-1.0, 1.0], switches), 6)
    machine = Machine(DriveParameters(mass, viscous, coulomb, gain), dead_time=late * dt)
    return drive_machine(machine, u, dt, step, phase=rng.uniform(0, step))


@cache
def strokes(late: float, seed: int = 1, step: float = CART[6]) -> MachineRun:
    """Simulate the cart under position control, from place to place."""
    gain, mass, viscous, coulomb, dt, _, _, _ = CART
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.uniform(0.1, 0.3, 14) * np.resize([1.0, -1.0], 14))
    blend = np.linspace(0, 1, 80) ** 2 * (3 - 2 * np.linspace(0, 1, 80))
    reference = np.concatenate(
        [np.r_[a + (b - a) * blend, np.full(40, b)] for a, b in zip(np.r_[0.0, places[:-1]], places, strict=True)]
    )
    machine = Machine(DriveParameters(mass, viscous, coulomb, gain), dead_time=late * dt)
    return control_machine(machine, reference, dt, step, kp=150.0, kd=5.0, u_max=12.0, phase=rng.uniform(0, step))


def made(method: type, axis: str, late: float | str) -> pmfid.IV:
    gain, _, _, _, dt, _, step, cutoff = AXES[axis]
    return method(Drive(gain, dead_time=late), Encoder(step), dt, cutoff)


def truth(axis: str) -> np.ndarray:
    return np.array(AXES[axis][1:4])


@pytest.mark.parametrize(
    ("axis", "late"),
    long_unless(
        lambda axis, late: late in (0.3, 2.0) and axis != "stage",
        [("cart", 0.3), ("cart", 4.6), ("wheel", 2.0), ("stage", 0.3)],
    ),
)
def test_the_fit_finds_it_and_instruments_that_are_given_it_agree(axis: str, late: float) -> None:
    run, dt = prbs(axis, late, switches=150), AXES[axis][4]
    u, counts = run.u[12:], run.counts[12:]  # so that an input of zero before the record has no effect
    fit = made(MotionFit, axis, "estimate").fit(u, counts)
    assert fit.names[-1] == "dead_time"
    assert fit.theta[-1] / dt == pytest.approx(late, abs=0.02)
    known = made(IV, axis, float(fit.theta[-1])).fit(u, counts)
    for one in (fit.theta[:3], known.theta):
        np.testing.assert_allclose(one / truth(axis), 1.0, atol=0.02)


@pytest.mark.parametrize("late", [0.0, 1.4])
def test_the_fit_finds_it_under_control(late: float) -> None:
    run = strokes(late)
    fit = made(MotionFit, "cart", "estimate").fit(run.u, run.counts)
    assert fit.theta[-1] / 0.01 == pytest.approx(late, abs=0.02)
    np.testing.assert_allclose(fit.theta[:3] / truth("cart"), 1.0, atol=0.005)


@pytest.mark.parametrize("method", [pmfid.LS, pmfid.BCLS, IV])
def test_a_known_dead_time_leaves_nothing_of_its_bias(method: type) -> None:
    run = prbs("cart", 1.3)
    known, none = (made(method, "cart", late).fit(run.u, run.counts).theta for late in (0.013, 0.0))
    np.testing.assert_allclose(known / truth("cart"), 1.0, atol=0.03)
    assert abs(none[0] / 1.07 - 1) > 0.15


def test_one_that_is_not_in_the_model_is_named_with_the_remedy_and_the_remedy_helps() -> None:
    run = prbs("stage", 0.6)
    gain, _, _, _, dt, _, step, cutoff = AXES["stage"]
    settings = {"encoder": Encoder(step), "dt": dt, "cutoff": cutoff}
    plain = pmfid.identify(run.u, run.counts, model=Drive(gain), **settings)
    assert plain.status == ("dead_time",)
    assert any('dead_time = "estimate"' in finding.remedy for finding in plain.findings)
    assert pmfid.identify(run.u, run.counts, model=Drive(gain, dead_time="estimate"), **settings).status == ()


WRONG_MODEL = Status.DEAD_TIME | Status.UNMODELLED


@pytest.mark.parametrize("axis", AXES)
def test_riv_says_on_line_that_the_input_acts_late(axis: str) -> None:
    run = prbs(axis, 0.6, switches=900)
    track = made(RIV, axis, 0.0).run(run.u, run.counts)
    assert track.status[-1] & WRONG_MODEL
    assert (
        track.has_status(Status.DEAD_TIME).any() or axis == "wheel"
    )  # for the wheel the status only says that the model is wrong


@pytest.mark.long
def test_next_to_friction_of_a_given_form() -> None:
    gain, mass, viscous, coulomb, dt, size, step, cutoff = WHEEL
    rng = np.random.default_rng(5)
    u = size * np.repeat(rng.choice([-1.0, 1.0], 400), 12)
    machine = Machine(
        DriveParameters(mass, viscous, coulomb, gain), stribeck=0.4 * coulomb, stribeck_speed=3.0, dead_time=1.7 * dt
    )
    run = drive_machine(machine, u, dt, step, phase=rng.uniform(0, step))
    fit = MotionFit(Drive(gain, dead_time="estimate", stribeck=3.0), Encoder(step), dt, cutoff).fit(run.u, run.counts)
    found = dict(zip(fit.names, fit.theta, strict=True))
    assert found["dead_time"] / dt == pytest.approx(1.7, abs=0.02)
    assert found["mass"] == pytest.approx(mass, rel=0.005)
    bar = fit.theta_std[fit.names.index("stribeck_friction")]
    assert abs(found["stribeck_friction"] - 0.4 * coulomb) < 3 * bar < coulomb


def test_saved_states_go_on_with_the_same_bits_and_hold_the_inputs_that_are_still_to_act() -> None:
    run = prbs("cart", 3.4)
    one = made(RIV, "cart", 0.034)
    one.run(run.u[:900], run.counts[:900])
    other = made(RIV, "cart", 0.034)
    other.set_state(one.get_state())
    np.testing.assert_array_equal(
        one.run(run.u[900:], run.counts[900:]).theta, other.run(run.u[900:], run.counts[900:]).theta
    )


def test_many_axes_have_the_bits_of_one() -> None:
    runs = [prbs("cart", late) for late in (0.0, 0.7, 1.3)]
    u, counts = np.array([run.u for run in runs]), np.array([run.counts for run in runs])
    many = Fleet(made(RIV, "cart", 0.007), 3).run(u, counts)
    for i, run in enumerate(runs):
        alone = made(RIV, "cart", 0.007).run(run.u, run.counts)
        np.testing.assert_array_equal(np.asarray(many.theta)[i, -1], alone.theta[-1])


def test_refusals_have_a_remedy() -> None:
    refused(
        ("ls does not estimate dead_time; use fit off-line", lambda: made(pmfid.LS, "cart", "estimate")),
        ("and dead_time does not; use fit off-line, or give its value", lambda: made(RIV, "cart", "estimate")),
        ("and dead_time does not; use fit off-line, or give its value", lambda: made(IV, "cart", "estimate")),
        ("shift the input column by whole samples", lambda: made(IV, "cart", 0.21)),
        (
            'write dead_time = "estimate"',
            lambda: Equation((Term("output", 2, "m"), Term("input", 1, "late")), (Term("input"),)),
        ),
        *(
            ("dead_time must be a time in s, at least 0", partial(Drive, 2.0, dead_time=value))
            for value in (-0.01, float("nan"), float("inf"), "guess", True, None)
        ),
    )
