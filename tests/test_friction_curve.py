"""Friction over velocity without an assumed law, on machines of the referee with a known law."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.pipeline.friction import FrictionCurve
from pmfid.types import Floats
from studies.referee.cases import Case, make_cases
from studies.referee.machines import draw_machine
from tests.command import run_command
from tests.conftest import long_unless

#: Index of a machine of each friction: PRBS, multisine, trapezoids and position control.
MACHINES = {"right": 5, "Stribeck 20 %": 0, "Stribeck 50 %": 2, "quadratic": 9, "asymmetry": 0}
SEED = 901


def law(kind: str, index: int, velocity: Floats) -> Floats:
    """Return the friction [N] of a machine of the referee at velocities (n,), by the law of its simulation."""
    machine = draw_machine(SEED, kind, index)
    size, effect = machine.scale, machine.effect
    resolution = size.turn / machine.increments
    speed, side = np.abs(velocity) * size.dt / resolution, np.sign(velocity)
    dry = machine.pace.coulomb + effect.get("quadratic", 0.0) * speed**2
    dry = dry + effect.get("stribeck", 0.0) * np.exp(-((speed / effect.get("stribeck_speed", 1.0)) ** 2))
    viscous = machine.pace.viscous * speed * (1 + effect.get("viscous_asymmetry", 0.0) * side)
    force = dry * (1 + effect.get("coulomb_asymmetry", 0.0) * side) + viscous
    return np.asarray(side * force * size.mass * resolution / (machine.pace.mass * size.dt**2))


@cache
def case_of(kind: str, index: int) -> Case:
    return make_cases(SEED, kind, [index])[0]


def curve_of(case: Case, **keys: object) -> FrictionCurve:
    axis = "rotary" if case.rotary else "linear"
    model = pmfid.Drive(case.input_gain, axis=axis, **keys)  # type: ignore[arg-type]
    return pmfid.friction_curve(case.u, case.counts, model=model, encoder=pmfid.Encoder(case.resolution), dt=case.dt)


@pytest.mark.parametrize("kind", long_unless("Stribeck 20 %".__eq__, MACHINES))
def test_the_law_is_within_the_band(kind: str) -> None:
    case = case_of(kind, MACHINES[kind])
    found = curve_of(case)
    error = found.force - law(kind, MACHINES[kind], found.velocity)
    assert np.mean(np.abs(error) < 2 * found.std) > 0.9
    assert np.max(np.abs(error) / found.std) < 4
    assert np.sqrt(np.mean(error**2)) < 0.02 * case.truth["coulomb"]
    assert np.median(found.std) < 0.02 * case.truth["coulomb"]
    assert abs(found.mass - case.truth["mass"]) < min(3 * found.mass_std, 0.005 * case.truth["mass"])
    assert found.status == ()


@pytest.mark.parametrize("command", ["friction", "encoder"])
def test_a_process_is_refused_with_the_remedy_for_the_log_of_a_machine(tmp_path: Path, command: str) -> None:
    (tmp_path / "run.csv").write_text("u,y\n1,0.1\n-1,0.2\n")
    (tmp_path / "axis.toml").write_text(
        '[record]\ninput = "u"\noutput = "y"\ndt = 0.01\n[model]\nkind = "transfer_function"\nn = 1\nm = 0\n'
    )
    refused = run_command(command, tmp_path / "run.csv", "--config", tmp_path / "axis.toml", code=2)
    assert 'give [model] kind = "drive"' in refused.stderr


def test_the_command_leaves_out_a_wrong_count(tmp_path: Path) -> None:
    case = case_of("Stribeck 20 %", 0)
    u, counts = case.u[:1200].tolist(), case.counts[:1200].astype(int).tolist()
    counts[700] += 40_000
    lines = [f"{value!r},{count}" for value, count in zip(u, counts, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["u,counts", *lines]) + "\n")
    (tmp_path / "axis.toml").write_text(
        f'[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ndt = {case.dt!r}\n'
        f"[encoder]\nresolution = {case.resolution!r}\n"
        f'[model]\ninput_gain = {float(case.input_gain)!r}\naxis = "{"rotary" if case.rotary else "linear"}"\n'
    )
    command = ["friction", str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml")]
    shown = run_command(*command, "--out", str(tmp_path / "out"))
    assert re.search(r"friction .*\n.*\[N", shown.output)
    reported = json.loads((tmp_path / "out" / "friction.json").read_text())
    mass = reported["inertia" if case.rotary else "mass"]
    assert mass["value"] == pytest.approx(case.truth["mass"], rel=0.005)
    assert any("701" in finding["sentence"] for finding in reported["findings"])
    assert "does not contain friction at rest" in (tmp_path / "out" / "friction.html").read_text()
