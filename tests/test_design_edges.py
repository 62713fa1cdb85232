"""Motions at the edge of a design: forward and back between limits, large inputs, few intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.design.polytope import input_set, violations
from pmfid.design.problem import Limits, Problem
from pmfid.design.solver import solve
from pmfid.design.standard import standard_inputs
from tests.command import run_command

EXAMPLE = Path(__file__).parents[1] / "examples" / "cart_design.toml"
NAMES = ("mass", "viscous_friction", "coulomb_friction")


def to_and_fro(
    values: tuple[float, float, float], gain: float, duration: float, rests: tuple[int, int], limits: Limits, size: int
) -> Problem:
    """Return the problem of a move forward, a rest, a move back, and a rest; `rests` are their lengths in intervals."""
    way = (size - sum(rests)) // 2
    directions = (1,) * way + (0,) * rests[0] + (-1,) * (size - sum(rests) - way) + (0,) * rests[1]
    return Problem(
        pmfid.Drive(gain),
        dict(zip(NAMES, values, strict=True)),
        NAMES,
        duration,
        size,
        limits,
        resolution=22.75e-6,
        end=(0.0, 0.0),
        directions=directions,
    )


LIGHT = ((0.18979340340880785, 1.599595856897632, 0.09556429941859632), 2.0, 3.6461140381518007, (3, 1))
#: The inputs are thousands, because a unit of input gives little force.
WEAK = ((33.39198165368409, 377.89086877893544, 2.0178120152151604), 0.2254297231411151, 2.110053474090249, (3, 1))


@pytest.mark.parametrize("low", [0.0, -1e-6])
@pytest.mark.parametrize(
    ("axis", "limits", "size"),
    [(LIGHT, (1.643239417820602, None, 1.0), 48), (WEAK, (8429.20775141835, 5057.524650851009, 1.0), 29)],
    ids=["light axis", "large inputs"],
)
def test_a_way_back_to_a_limit_of_position_is_feasible(axis: tuple, limits: tuple, size: int, low: float) -> None:
    highest, rms, far = limits
    bounds = Limits(input=highest, rms=rms, position=(low, far), min_speed=0.001)
    problem = to_and_fro(*axis, bounds, size)
    inputs = input_set(problem)
    for found in standard_inputs(problem, names=("minimum_energy", "pulses", "chirp")).values():
        assert not {name: much for name, much in violations(inputs, found.u).items() if much > 1e-5 * highest}
    assert solve(problem, "D", starts=1).feasible


@pytest.mark.parametrize("certify", ["0", "1"])
def test_a_run_of_two_samples_cannot_tell_three_parameters(tmp_path: Path, certify: str) -> None:
    spec = tmp_path / "two.toml"
    spec.write_text(EXAMPLE.read_text().replace("intervals = 40", "intervals = 2"))
    result = run_command("design", str(spec), "--set", "search.starts=2", "--certify", certify, code=3)
    assert "2 samples" in result.stderr
    assert "samples_per_interval" in result.stderr
    assert result.stdout == ""


def test_the_remedies_for_too_few_samples_help(tmp_path: Path) -> None:
    two = EXAMPLE.read_text().replace("intervals = 40", "intervals = 2")
    three = '["mass", "viscous_friction", "coulomb_friction"]'
    for text in (
        two.replace("resolution = 22.75e-6", "resolution = 22.75e-6\nsamples_per_interval = 20"),
        two.replace(three, '["mass"]'),
        two + "\n[prior]\nviscous_friction = 0.6\ncoulomb_friction = 0.06\n",
    ):
        spec = tmp_path / "mended.toml"
        spec.write_text(text)
        run_command("design", str(spec), "--set", "search.starts=2", "--certify", "1")


def test_three_samples_tell_three_parameters() -> None:
    problem = Problem(
        pmfid.Drive(2.0), {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}, NAMES, 2.0, 3,
        Limits(input=3.0, min_speed=0.01), resolution=1e-5,
    )  # fmt: skip
    assert np.isfinite(list(solve(problem, "D", starts=2).predicted_std.values())).all()
