"""Two masses on a spring: the body against an independent integrator, its derivatives, and the fit."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid._body import BASE, ELASTIC_BASE, KINDS, run
from pmfid.design.body import simulate as move
from pmfid.design.problem import Limits, Problem
from pmfid.fit.driven import driven_guesses
from pmfid.types import Counts, Floats
from tests.command import run_command
from tests.oracles.two_mass import TwoMasses, simulate_two_masses
from tests.refusals import refused

STEP = 0.002
RNG = np.random.default_rng(5)
INPUT = np.ascontiguousarray(RNG.uniform(-1, 1, 40).repeat(8))
#: Motor, its friction, load and its friction, spring: a resonance of 20 Hz and one of 60 Hz.
PAIRS = [(0.5, 0.5, 0.1, 0.5, 0.3, 0.15, 3947.8, 1.2566), (0.2, 0.3, 0.05, 0.8, 0.4, 0.2, 22739.6, 6.0319)]


def body_of(pair: tuple[float, ...], delay: float = 0.0) -> Floats:
    theta = np.zeros(ELASTIC_BASE)
    theta[[0, 1, 2, BASE, BASE + 1, BASE + 2, BASE + 3, BASE + 4]] = pair
    theta[[5, BASE + 5, BASE + 6]] = delay, 0.001, 0.02
    return theta


def simulate(theta: Floats, forces: list[object] | None = None, load: bool = False) -> list[Floats]:
    row, clock, none = np.arange(INPUT.size + 1, dtype=np.int32), np.full(INPUT.size, STEP), np.zeros((0, INPUT.size))
    y, v, S, rows = run(forces or [], clock, INPUT, row, none, theta, 2, np.eye(theta.size), elastic=True, load=load)  # type: ignore[arg-type]
    assert rows == INPUT.size + 1
    return [y, v, S]


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("load", [False, True])
def test_the_motion_is_that_of_an_independent_integrator(pair: tuple[float, ...], load: bool) -> None:
    theta = body_of(pair)
    start = np.array([0.001, 0.02, 0.0, 0.0] if load else [0.0, 0.0, 0.001, 0.02])
    truth = simulate_two_masses(TwoMasses(*pair), INPUT, STEP, start)
    y, v, _ = simulate(theta, load=load)
    assert np.max(np.abs(y - truth[:, 2 * load])) < 1e-8 * np.ptp(y)
    assert np.max(np.abs(v - truth[:, 2 * load + 1])) < 1e-7 * np.ptp(v)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize(("load", "shown"), [(False, False), (True, False), (True, True)])
def test_the_derivatives_are_those_of_the_motion(pair: tuple[float, ...], load: bool, shown: bool) -> None:
    forces: list[object] = [(KINDS["wave"], 0, False, np.zeros(1), 0.1, 0.3, load)]
    theta = np.append(body_of(pair, 0.3 * STEP), 0.02)
    slopes = simulate(theta, forces, shown)[2]
    # a start velocity of 0 within friction has no derivative, and a gap of 0 has none either
    for index in [*range(6), 7, *range(BASE, BASE + 7), ELASTIC_BASE]:
        step = np.zeros(theta.size)
        step[index] = 1e-8 if index == 5 else 1e-6 * max(abs(theta[index]), 1e-3)
        ahead, back = simulate(theta + step, forces, shown)[0], simulate(theta - step, forces, shown)[0]
        quotient = (ahead - back) / (2 * step[index])
        assert np.max(np.abs(quotient - slopes[:, index])) < 2e-4 * np.max(np.abs(quotient)), index


@cache
def record(
    seed: int = 3, pair: int = 0, hold: int = 12, load: bool = False, resolution: float = 1e-5, kind: type = TwoMasses
) -> tuple[Floats, Counts, float]:
    u = np.random.default_rng(seed).uniform(-1, 1, 1800 // hold).repeat(hold)
    y = simulate_two_masses(kind(*PAIRS[pair]), u[:-1], STEP, np.zeros(4), 10)[:, 2 * load]
    return u, np.floor(y / resolution + 0.4).astype(np.int64), resolution


class SmoothPair(TwoMasses):
    """Two masses whose friction is a smooth function of the speed."""

    def advance(self, state: Floats, force: float, h: float) -> Floats:
        return self.step(state, force, [1, 1, 1], h)

    def rates(self, state: Floats, force: float, way: list[int]) -> Floats:
        first, second = np.tanh(state[1::2] / 0.05)
        smooth = replace(self, coulomb=first * self.coulomb, load_coulomb=second * self.load_coulomb)
        return TwoMasses.rates(smooth, state, force, way)


@pytest.fixture(scope="module", params=[False, True])
def result(request: pytest.FixtureRequest) -> pmfid.Result:
    u, counts, resolution = record(5 if request.param else 3, load=request.param)
    drive = pmfid.Drive(1.0, body="two-mass", output="load" if request.param else "motor")
    return pmfid.identify(u, counts, model=drive, dt=STEP, encoder=pmfid.Encoder(resolution))


def test_both_masses_and_the_spring_are_found(result: pmfid.Result) -> None:
    names = ("motor_mass", "viscous_friction", "coulomb_friction", "load_mass", "load_viscous_friction")
    assert result.names == (*names, "load_coulomb_friction", "stiffness", "damping")
    truth = np.array(PAIRS[0])
    part = np.abs(result.theta / truth - 1)
    assert np.all(part[[0, 3, 6]] < 2e-4), part
    assert np.all(part < 0.02), part
    assert np.sum((result.interval_95[:, 0] <= truth) & (truth <= result.interval_95[:, 1])) >= 7
    assert np.all(np.ptp(result.interval_95, axis=1)[[0, 3, 6]] < 5e-4 * truth[[0, 3, 6]])


def test_the_first_guess_is_near_the_truth() -> None:
    u, counts, resolution = record(resolution=1e-8)
    method = pmfid.MotionFit(pmfid.Drive(1.0, body="two-mass"), pmfid.Encoder(resolution), STEP, 20.0)
    guess = next(driven_guesses(method.problem(u, counts).stretches[0], resolution))
    np.testing.assert_allclose(guess[[0, 4, 7]], np.array(PAIRS[0])[[0, 3, 6]], rtol=0.02)


@pytest.mark.parametrize(("kind", "shown"), [(TwoMasses, ", with a resonance at 60 Hz,"), (SmoothPair, "")])
def test_a_rigid_axis_names_the_second_mass(kind: type, shown: str) -> None:
    u, counts, resolution = record(4, pair=1, hold=48, kind=kind)  # slow, so that only friction is wrong
    rigid = pmfid.identify(u, counts, model=pmfid.Drive(1.0), dt=STEP, encoder=pmfid.Encoder(resolution))
    (named,) = [one for one in rigid.findings if one.code == "two_mass"]
    assert rigid["mass"] == pytest.approx(1.0, rel=0.02)
    totals = re.findall(r"The sum of viscous_friction over both masses is ([0-9.]+),", named.detail)
    assert [float(total) for total in totals] == ([pytest.approx(0.7, rel=2e-3)] if shown else [])
    assert "two_mass" in rigid.status
    assert named.sentence == f"a second mass on a spring{shown} explains the record better"
    assert named.remedy == 'set body = "two-mass" in [model]'


@pytest.mark.parametrize("method", ["riv", "bcls", "rls", "iv"])
def test_other_methods_name_the_way_off_line(method: str) -> None:
    u, counts, resolution = record()
    drive = pmfid.Drive(1.0, body="two-mass")
    settings = {"model": drive, "dt": STEP, "encoder": pmfid.Encoder(resolution), "method": method}
    way = 'two-mass axis off-line: pmfid identify with method = "fit"'
    refused((way, lambda: pmfid.identify(u, counts, **settings)))


def test_the_command_takes_the_body(tmp_path: Path) -> None:
    u, counts, resolution = record()
    np.savetxt(tmp_path / "log.csv", np.column_stack([u, counts]), "%.9g", ",", header="u,counts", comments="")
    (tmp_path / "AXIS.toml").write_text(
        '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ndt = 0.002\n'
        f'[encoder]\nresolution = {resolution}\n[model]\ninput_gain = 1.0\nbody = "two-mass"\n',
        encoding="utf-8",
    )
    log, axis = str(tmp_path / "log.csv"), str(tmp_path / "AXIS.toml")
    found = json.loads(run_command("identify", log, "--config", axis, "--json").stdout)
    assert found["parameters"]["stiffness"]["value"] == pytest.approx(3947.8, rel=0.005)
    choice = json.loads(run_command("encoder", log, "--config", axis, "--parameter", "stiffness", "--json").stdout)
    names = pmfid.MotionFit(pmfid.Drive(1.0, body="two-mass"), pmfid.Encoder(resolution), STEP, 20.0).names
    nominal = dict(zip(names, PAIRS[0], strict=True))
    belt = Problem(pmfid.Drive(1.0, body="two-mass"), nominal, names, STEP * u.size, u.size, Limits(), 1.0)
    slopes = move(belt, u).slopes * PAIRS[0]
    root = np.linalg.pinv(slopes - slopes.mean(axis=0))[names.index("stiffness")]
    predicted = np.array(choice["step"]) / np.sqrt(12) * np.linalg.norm(root)
    assert choice["counts"] == pytest.approx(predicted, rel=0.1)
    assert choice["edges"] == []
    for command in (["export", axis, "--out", str(tmp_path / "out")], ["monitor", log, "--config", axis]):
        assert "off-line" in run_command(*command, code=2).stderr
