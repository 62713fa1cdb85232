"""Forces and friction that depend on the place, in every method, in a fleet, in saved states and in AXIS.toml."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import pmfid
from pmfid.models.shapes import Along, Square, Stribeck, Wave
from pmfid.pipeline.arrays import axis_of
from pmfid.simulation.drive import DriveParameters, Machine, MachineRun, drive_machine

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
