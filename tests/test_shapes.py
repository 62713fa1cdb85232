"""Forces of a given form: their tables, the motion that they cause, and their estimates by all methods."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

import pmfid
from pmfid.estimators.iv import IV
from pmfid.fit.machine import Excitation, machine_of, simulate
from pmfid.models.equation import Equation
from pmfid.models.shapes import Shape, Square, Stribeck, Wave
from pmfid.simulation.drive import DriveParameters, Machine, MachineRun, drive_machine
from pmfid.types import Floats
from tests.refusals import refused


@dataclass(frozen=True)
class Case:
    """A machine and its measurement; the input holds each level for `hold` samples."""

    drive: DriveParameters
    dt: float
    cutoff: float
    resolution: float
    hold: int


CASES = {
    "cart": Case(DriveParameters(1.07, 12.8, 0.8, 12.5), 0.01, 20.0, 91e-6, 8),
    "wheel": Case(DriveParameters(1e-5, 2e-5, 1e-3, 0.01), 5e-4, 60.0, 2 * math.pi / 4096, 40),
    "gantry": Case(DriveParameters(500.0, 900.0, 120.0, 300.0), 0.02, 6.0, 1e-3, 12),
    "stage": Case(DriveParameters(12.0, 60.0, 8.0, 40.0), 0.002, 30.0, 1e-5, 25),
    "spindle": Case(DriveParameters(2e-3, 4e-3, 0.05, 0.4), 1e-3, 40.0, 2 * math.pi / 2048, 40),
}


def made(name: str, seed: int = 0, samples: int = 3000, **parts: float) -> tuple[MachineRun, Machine, Case]:
    """Return a run with frictions as fractions of Coulomb friction; the Stribeck speed is a tenth of the usual
    speed.
    """
    case, rng = CASES[name], np.random.default_rng(seed)
    levels = rng.choice([-1.0, -0.6, -0.35, 0.0, 0.35, 0.6, 1.0], samples // case.hold + 1)
    u = levels.repeat(case.hold)[:samples] * 4 * case.drive.coulomb_friction / case.drive.input_gain
    usual = float(np.std(drive_machine(Machine(case.drive), u, case.dt, case.resolution).v))
    coulomb = case.drive.coulomb_friction
    machine = Machine(
        case.drive,
        stribeck=coulomb * parts.get("stribeck", 0.0),
        stribeck_speed=0.1 * usual,
        quadratic=coulomb * parts.get("quadratic", 0.0) / usual**2,
    )
    return drive_machine(machine, u, case.dt, case.resolution, phase=0.4 * case.resolution, steps=40), machine, case


def truth(machine: Machine, names: tuple[str, ...]) -> np.ndarray:
    values = {
        "mass": machine.drive.mass,
        "viscous_friction": machine.drive.viscous_friction,
        "coulomb_friction": machine.drive.coulomb_friction,
        "stribeck_friction": machine.stribeck,
        "quadratic_friction": machine.quadratic,
        "stribeck_speed": machine.stribeck_speed,
    }
    return np.array([values[name] for name in names])


def model(machine: Machine, **own: object) -> pmfid.Drive:
    return pmfid.Drive(machine.drive.input_gain, **own)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("shape", "form"),
    [
        (Stribeck(0.03), lambda v: np.exp(-((v / 0.03) ** 2))),
        (Square(), lambda v: v**2),
        (Wave(0.4), lambda x: np.sin(2 * math.pi * x / 0.4)),
        (Wave(0.4, cosine=True), lambda x: np.cos(2 * math.pi * x / 0.4)),
    ],
)
def test_a_table_is_the_form(shape: Shape, form: object) -> None:
    at = np.linspace(0.0, 0.5, 20_001)
    wanted, got = form(at), shape.evaluate(at)  # type: ignore[operator]
    assert np.max(np.abs(got - wanted)) < 2e-3
    assert abs(np.mean(got - wanted)) < 2e-5  # the mean over the table is much closer


def moved(equation: Equation, theta: Floats, dt: float, u: Floats, parts: int) -> Floats:
    """Return the positions (n,) of the body of the fit under the input u (n,), from rest."""
    machine, row = machine_of(equation), np.arange(u.size, dtype=np.int32)
    drive = Excitation(np.full(u.size, dt), u * equation.input_gain, row, np.zeros((0, u.size)))
    return simulate(drive, machine.forces, machine.body(theta), parts)[0]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("parts", [{"stribeck": 0.5}, {"quadratic": 0.3}, {"stribeck": 0.2, "quadratic": 0.2}])
def test_the_motion_is_that_of_the_machine(name: str, parts: dict[str, float]) -> None:
    """The motion agrees with the Runge-Kutta integration; its error falls with the cube of the number of parts."""
    run, machine, case = made(name, samples=1500, **parts)
    equation = model(machine, stribeck=machine.stribeck_speed, quadratic=True).equation
    theta, errors = truth(machine, equation.names), []
    for count in (2, 8):
        x = moved(equation, theta, case.dt, run.u, count)
        errors.append(float(np.max(np.abs(x - run.x))) / float(np.ptp(run.x)))
    assert errors[0] < 1e-3
    assert errors[1] < max(errors[0] / 32, 3e-6)


@pytest.mark.parametrize("name", ["cart", "gantry"])
def test_the_fit_finds_stribeck_and_quadratic_friction(name: str) -> None:
    run, machine, case = made(name, 3, stribeck=0.3, quadratic=0.2)
    own = model(machine, stribeck=machine.stribeck_speed, quadratic=True)
    fit = pmfid.MotionFit(own, pmfid.Encoder(case.resolution), case.dt, case.cutoff).fit(run.u, run.counts)
    wanted = truth(machine, fit.names)
    assert np.all(np.abs(fit.theta - wanted) < 4 * fit.theta_std)
    assert np.all(fit.theta_std < 0.03 * wanted)


@pytest.mark.parametrize("name", ["cart", "stage"])
def test_riv_finds_quadratic_friction_and_its_bars_hold(name: str) -> None:
    """The direct estimate at the start takes quadratic friction for viscous friction. The sums must forget this
    start.
    """
    run, machine, case = made(name, 7, 4000, quadratic=0.2)
    own = model(machine, quadratic=True)
    track = pmfid.RIV(own, pmfid.Encoder(case.resolution), case.dt, case.cutoff).run(run.u, run.counts)
    wanted = truth(machine, track.names)
    assert np.all(np.abs(track.theta[-1] - wanted) < 3 * track.theta_std[-1])
    assert np.all(track.theta_std[-1] < 0.1 * wanted)


def test_the_equation_holds_for_the_simulated_motion() -> None:
    """Regressors and target of the model's own motion leave hardly any residual at the simulated parameters."""
    run, machine, case = made("cart", stribeck=0.5, quadratic=0.3)
    own = model(machine, stribeck=machine.stribeck_speed, quadratic=True)
    estimator = IV(own, pmfid.Encoder(1e-7), case.dt, case.cutoff)
    theta = truth(machine, estimator.names)
    counts = np.floor(moved(estimator.equation, theta, case.dt, run.u, 4) / 1e-7).astype(np.int64)
    columns = estimator.columns_at(theta, run.u, counts)
    assert np.std(columns.z - columns.phi @ theta) < 1e-3 * np.std(columns.z)


def test_what_has_no_such_form_is_refused_with_a_remedy() -> None:
    def made_by(method: type[pmfid.LS], speed: float | str) -> pmfid.LS:
        return method(pmfid.Drive(1.7, stribeck=speed), pmfid.Encoder(3e-5), 2e-3, 31.0)  # type: ignore[arg-type]

    plain = (pmfid.LS, pmfid.BCLS, pmfid.RLS, pmfid.BCRLS)
    refused(
        *((r"stribeck_friction.*use iv, riv or fit", lambda m=m: made_by(m, 0.02)) for m in plain),
        *((r"stribeck_speed does not.*fit", lambda m=m: made_by(m, "estimate")) for m in (pmfid.IV, pmfid.RIV)),
        *(("peed", lambda v=v: made_by(pmfid.IV, v)) for v in (0.0, -0.1, math.nan, math.inf, True, "estimated")),
    )


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_fleet_keeps_what_it_knows_of_them_from_call_to_call(precision: str) -> None:
    run, _, case = made("cart", stribeck=0.5)
    model = pmfid.Drive(case.drive.input_gain, stribeck=0.05)
    estimator = pmfid.RIV(model, pmfid.Encoder(case.resolution), case.dt, case.cutoff, precision=precision)
    fleet = pmfid.Fleet(estimator, 2)
    alone = estimator.run(run.u, run.counts)
    assert not alone.status[-1] & pmfid.Status.FALLBACK
    for part in np.array_split(np.arange(run.u.size), 4):
        tracks = fleet.run(np.tile(run.u[part], (2, 1)), np.tile(run.counts[part], (2, 1)))
    np.testing.assert_array_equal(tracks.theta[1, -1], alone.theta[-1])
