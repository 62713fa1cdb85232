"""Forces and friction that depend on the place, in every method, in a fleet, in saved states and in AXIS.toml."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.config.model import ModelConfig
from pmfid.models.shapes import Along, Square, Stribeck, Wave
from pmfid.pipeline.arrays import axis_of
from pmfid.simulation import control_machine, multisine
from pmfid.simulation.drive import DriveParameters, Machine, MachineRun, drive_machine
from tests.refusals import refused

AXIS = DriveParameters(mass=2e-3, viscous_friction=4e-3, coulomb_friction=0.05, input_gain=0.4)
DT, CUTOFF, STEP, HOLD = 1e-3, 40.0, 2 * math.pi / 8192, 40
ANGLE, PITCH = 0.7, 1.3
#: Fractions of Coulomb friction.
PARTS = {"gravity": 1.5, "cogging": 0.4, "uneven": 0.4}
FORCE = AXIS.coulomb_friction
MODELS = {
    "gravity": pmfid.Drive(0.4, gravity=True),
    "cogging": pmfid.Drive(0.4, cogging=PITCH),
    "uneven": pmfid.Drive(0.4, friction_period=PITCH),
}
#: Length of a period in units of y, and the phase angle of the force at the place 0.
PERIODS = {"gravity": (2 * math.pi, ANGLE), "cogging": (PITCH, ANGLE), "uneven": (PITCH, 0.0)}


def run_of(force: str, seed: int, samples: int = 4000) -> MachineRun:
    """Return a run that begins in the middle of a count, the origin of the place for the methods."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-1.0, -0.6, -0.35, 0.0, 0.35, 0.6, 1.0], samples // HOLD + 1)
    u = levels.repeat(HOLD)[:samples] * 4 * AXIS.coulomb_friction / AXIS.input_gain
    machine = replace(
        Machine(AXIS, gravity_angle=ANGLE, cogging_pitch=PITCH, cogging_phase=ANGLE, uneven_period=PITCH),
        **{force: FORCE * PARTS[force]},
    )
    return drive_machine(machine, u, DT, STEP, phase=STEP / 2, steps=20)


def truth(force: str) -> np.ndarray:
    size, angle = FORCE * PARTS[force], PERIODS[force][1]
    waves = [size * math.cos(angle), size * math.sin(angle)]
    return np.array([AXIS.mass, AXIS.viscous_friction, AXIS.coulomb_friction, *waves])


@pytest.mark.parametrize("force", MODELS)
def test_the_fit_finds_it(force: str) -> None:
    run = run_of(force, 1)
    fit = pmfid.MotionFit(MODELS[force], pmfid.Encoder(STEP), DT, CUTOFF).fit(run.u, run.counts)
    wanted = truth(force)
    assert np.all(np.abs(fit.theta - wanted) < 4 * fit.theta_std + 2e-4 * np.max(np.abs(wanted)))
    assert np.all(fit.theta_std[3:] < 0.02 * FORCE)
    np.testing.assert_allclose(fit.theta[:3], wanted[:3], rtol=0.01)


@pytest.mark.parametrize("force", MODELS)
def test_instruments_find_it_and_least_squares_nearly(force: str) -> None:
    run, wanted = run_of(force, 2), truth(force)
    fit = pmfid.IV(MODELS[force], pmfid.Encoder(STEP), DT, CUTOFF).fit(run.u, run.counts)
    assert np.all(np.abs(fit.theta - wanted) < 4 * fit.theta_std)
    least = pmfid.LS(MODELS[force], pmfid.Encoder(STEP), DT, CUTOFF).fit(run.u, run.counts)
    assert np.all(np.abs(least.theta[3:] - wanted[3:]) < 0.3 * FORCE * PARTS[force])


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_fleet_has_the_bits_of_one_axis(precision: str) -> None:
    run = run_of("cogging", 3, 1500)
    model = replace(MODELS["cogging"], stribeck=0.3, quadratic=True)
    estimator = pmfid.RIV(model, pmfid.Encoder(STEP), DT, CUTOFF, forgetting=0.999, precision=precision)
    tracks = pmfid.Fleet(estimator, 3).run(np.tile(run.u, (3, 1)), np.tile(run.counts, (3, 1)))
    alone = estimator.run(run.u, run.counts)
    for axis in range(3):
        np.testing.assert_array_equal(tracks.theta[axis, -1], alone.theta[-1])


def test_a_saved_state_goes_on() -> None:
    run = run_of("gravity", 4, 3000)
    model = replace(MODELS["gravity"], stribeck=0.3)
    estimator = pmfid.RIV(model, pmfid.Encoder(STEP), DT, CUTOFF, forgetting=0.999)
    whole = estimator.run(run.u, run.counts)
    estimator.reset()
    estimator.run(run.u[:1000], run.counts[:1000])
    other = estimator.start(estimator.get_state())
    np.testing.assert_array_equal(other.run(run.u[1000:], run.counts[1000:]).theta[-1], whole.theta[-1])


def test_what_the_direct_estimate_lacks_is_not_known() -> None:
    run = run_of("gravity", 5, 400)
    model = replace(MODELS["gravity"], stribeck=0.3)
    track = pmfid.RIV(model, pmfid.Encoder(STEP), DT, CUTOFF).run(run.u, run.counts)
    borrowed = (track.status & pmfid.Status.FALLBACK != 0) & (track.status & pmfid.Status.STARTING == 0)
    assert np.any(borrowed)
    assert np.all(track.theta_std[borrowed][:, 3] > 1e3)


def test_a_force_of_the_model_is_no_missing_force() -> None:
    run = run_of("uneven", 6)
    statuses = {}
    for name, model in {"without": pmfid.Drive(0.4), "with": MODELS["uneven"]}.items():
        encoder = pmfid.Encoder(STEP)
        statuses[name] = pmfid.identify(run.u, run.counts, model=model, encoder=encoder, dt=DT).status
    assert "unmodelled" in statuses["without"]
    assert statuses["with"] == ()


def test_keys_of_axis_toml_are_those_of_a_drive() -> None:
    keys = {"stribeck": 0.02, "quadratic": True, "gravity": 6.3, "cogging": 0.01, "friction_period": 0.4}
    model = ModelConfig.model_validate({"input_gain": 2.0, **keys}).make()
    assert model == pmfid.Drive(2.0, **keys)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="stribeck belongs to kind"):
        ModelConfig.model_validate({"kind": "equation", "stribeck": 0.02, "unknown": []})


def test_what_has_no_such_place_is_refused() -> None:
    model = pmfid.Drive(2.0, gravity=True, cogging=0.01, friction_period=0.4, stribeck=0.02, quadratic=True)
    keys, lengths = ("cogging", "friction_period", "gravity"), (0.0, -1.0, math.nan, math.inf)
    term = {"signal": "friction", "name": "low", "shape": {"form": "stribeck", "period": 0.3}}
    section = {"kind": "equation", "unknown": [term]}
    refused(
        (r"8 forces of a given form", lambda: pmfid.RIV(model, pmfid.Encoder(1e-3), 1e-3, 30.0)),
        (r"8 forces of a given form.*use fewer", lambda: pmfid.MotionFit(model, pmfid.Encoder(1e-3), 1e-3, 30.0)),
        *(
            ("period must be a number above 0", lambda key=key, x=x: pmfid.Drive(2.0, **{key: x}))
            for key in keys
            for x in lengths
        ),
    )
    refused(
        (
            r"got stribeck with \['period'\]",
            lambda: ModelConfig.model_validate(section),
        ),
        kind=ValueError,
    )


def test_terms_of_the_users_own_go_through_axis_toml() -> None:
    """`pmfid.identify` writes the keys of [model] that make the same equation."""
    terms = (
        pmfid.Term("output", 2, "inertia", "kg m2"),
        pmfid.Term("output", 1, "viscous", "N m s"),
        pmfid.Term("direction", 0, "coulomb", "N m"),
        pmfid.Term("friction", 0, "low", "N m", shape=Stribeck(0.3)),
        pmfid.Term("friction", 0, "fast", "N m s2", shape=Square()),
        pmfid.Term("place", 0, "sine", "N m", shape=Wave(PITCH)),
        pmfid.Term("place", 0, "cosine", "N m", shape=Wave(PITCH, cosine=True)),
        pmfid.Term("place", 0, "known", "N m", shape=Along(-1.0, 1.0, [0.0, 1.0, 0.0])),
    )
    model = pmfid.EquationModel(pmfid.Equation(terms, (pmfid.Term("input", coefficient=0.4),)))
    axis = axis_of(model, pmfid.Encoder(STEP), DT, {"cutoff": CUTOFF})
    assert axis.model.make() == model


def test_an_arm_that_is_held_upright_is_followed() -> None:
    """The arm falls without its controller, so that the input alone leads no motion along the record."""
    arm = Machine(DriveParameters(2.0, 1.2, 3.0, 1.0), gravity=12.0, gravity_angle=math.pi - 0.2)
    reference = multisine(1600, 0.01, np.array([0.3, 0.55, 0.9]), 0.6, np.random.default_rng(3))
    run = control_machine(arm, reference, 0.01, 2 * math.pi / 4096, kp=128.0, kd=22.0, u_max=60.0, steps=20)
    method = pmfid.MotionFit(pmfid.Drive(1.0, gravity=True), pmfid.Encoder(2 * math.pi / 4096), 0.01, 10.0)
    fit = method.fit(run.u, run.counts)
    np.testing.assert_array_less(np.abs(fit.theta[:3] - [2.0, 1.2, 3.0]), 4 * fit.theta_std[:3])
    np.testing.assert_array_less(fit.theta_std[:3], [0.002, 0.01, 0.01])
