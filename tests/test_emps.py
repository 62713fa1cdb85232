"""The measured EMPS drive through the command, against its published parameters (Janot, Gautier, Brunot 2019)."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.command import run_command
from tests.conftest import EMPS, needs_emps, unjudged

pytestmark = needs_emps

AXIS = Path(__file__).parents[1] / "examples" / "emps.toml"
MASS, VISCOUS_FRICTION, COULOMB_FRICTION, OFFSET = 95.11, 203.5, 20.39, -3.16
HALF_MILLIMETRE = ("--set", "encoder.resolution=5e-4", "--set", "estimator.cutoff=100", "--set", "estimator.order=2")


def identified(*options: str, judged: bool = True) -> dict[str, float]:
    """Return the parameters that `pmfid identify DATA_EMPS.mat` prints, by name.

    `judged` includes the status, which takes most of the time.
    """
    with nullcontext() if judged else unjudged():
        result = run_command("identify", EMPS, "--config", AXIS, "--json", *options)
    assert [line for line in result.stderr.splitlines() if not line.startswith("pmfid: identify: ")] == []
    printed = json.loads(result.stdout)
    assert printed["samples"] == 24841
    return {name: entry["value"] for name, entry in printed["parameters"].items()}


@pytest.mark.parametrize("method", ["ls", "rls"])
def test_fine_encoder_gives_the_published_parameters_by_least_squares(method: str) -> None:
    found = identified("--method", method, "--set", "estimator.cutoff=50", judged=method == "ls")
    assert found["mass"] == pytest.approx(MASS, rel=0.01)
    assert found["viscous_friction"] == pytest.approx(VISCOUS_FRICTION, rel=0.03)
    assert found["coulomb_friction"] == pytest.approx(COULOMB_FRICTION, rel=0.03)
    assert found["offset"] == pytest.approx(OFFSET, rel=0.05)


@pytest.mark.parametrize("method", ["bcls", "bcrls"])
@pytest.mark.long
def test_half_a_millimetre_is_compensated(method: str) -> None:
    found = identified("--method", method, *HALF_MILLIMETRE, judged=method == "bcls")
    assert found["mass"] == pytest.approx(MASS, rel=0.05)
    assert found["viscous_friction"] == pytest.approx(VISCOUS_FRICTION, rel=0.2)
    assert found["coulomb_friction"] == pytest.approx(COULOMB_FRICTION, rel=0.2)


def test_the_fit_names_the_friction_of_each_direction() -> None:
    """Viscous friction of this axis is 166 N s/m in one direction and 232 N s/m in the other."""
    printed = json.loads(run_command("identify", EMPS, "--config", AXIS, "--json", "--method", "auto").stdout)
    mass = printed["parameters"]["mass"]
    assert mass["value"] == pytest.approx(MASS, rel=0.02)
    assert mass["interval_95"][0] < MASS < mass["interval_95"][1]
    assert "unmodelled" in printed["status"]
    assert any("differs by direction" in note for note in printed["notes"])
