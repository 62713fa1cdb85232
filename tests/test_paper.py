"""The page on the paper: its index is true, and small runs give the verdicts that it prints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid.simulation import CART, Schedule
from studies.paper import page
from studies.paper.__main__ import main
from studies.paper.claims import CLAIMS, Claim
from studies.paper.designs import settling_time
from studies.paper.equations import INDEX, check_row, index_table
from studies.paper.inputs import STROKE, designed, experiments, information, miss_end, problem, pulse
from studies.paper.runs import controlled, known_mass, mass_errors, step_at, track
from tests.refusals import refused

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/paper.md").read_text(encoding="utf-8")


# --- the index --------------------------------------------------------------------------------------------------------


def test_the_index_of_the_page_is_the_index_of_the_code() -> None:
    """And has every equation of the paper, and no row that names nothing."""
    assert "\n".join(index_table()) in PAGE + "\n"
    covered = {number for row in INDEX for number in range(row.first, row.last + 1)}
    assert covered == set(range(1, 44))
    refused(
        ("has no quantise", lambda: check_row(replace(INDEX[0], code="pmfid.encoder:quantise", here=""))),
        ("has no test_nothing", lambda: check_row(replace(INDEX[0], test="test_filters:test_nothing"))),
        kind=LookupError,
    )


# --- figures and claims -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", page.FIGURES)
def test_a_figure_has_the_verdict_of_the_page(name: str, tmp_path: Path) -> None:
    finding = page.FIGURES[name](2, tmp_path)
    assert f"**Here:** {finding.verdict}." in PAGE.partition(f"## Figure {name}\n")[2].partition("\n## ")[0]
    for picture in page.PICTURES[name]:
        assert (tmp_path / f"{picture}.png").stat().st_size > 10_000
        assert (ROOT / f"docs/images/paper/{picture}.png").exists()


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.check.__name__)
def test_a_claim_has_the_verdict_of_the_page(claim: Claim) -> None:
    finding = claim.check(3)
    assert f"| {claim.section} | {claim.statement} | {finding.verdict} |" in PAGE


def test_rls_goes_off_with_coarse_encoders_and_bcrls_does_not() -> None:
    """The errors [%] of the issue that asked for this page, with filters of 7 ms."""
    fine, coarse = ([controlled(n, seed, 20.0) for seed in range(2)] for n in (4096, 256))
    assert abs(mass_errors("rls", fine, 150.0, own=True)[0]) < 1.5
    assert mass_errors("rls", coarse, 150.0, own=True)[0] < -25
    assert abs(mass_errors("bcrls", coarse, 150.0, own=True)[0]) < 1.5


def test_a_step_of_the_mass_is_followed() -> None:
    schedule = step_at(10.0)
    assert isinstance(schedule, Schedule)
    mass = known_mass(track("bcrls", controlled(1024, 0, 20.0, schedule)))
    assert np.isnan(mass[0])
    assert mass[[990, -1]] == pytest.approx([1.07, 1.44], rel=0.02)


# --- inputs -----------------------------------------------------------------------------------------------------------


def test_every_input_does_the_same_errand_and_the_design_has_more_information_than_pulses() -> None:
    for name, u in experiments().items():
        assert abs(miss_end(u)) < 1e-4, name
        assert np.abs(u).max() <= 3.0 + 1e-9, name
    assert set(pulse().tolist()) >= {0.0, 3.0}
    assert problem().end == (STROKE, 0.0)
    known = {name: information(u)[0] for name, u in experiments().items()}
    assert known["design (5) with rest"] > 1.2 * known["one pulse"]
    assert known["design (5)"] > 1.2 * known["four pulses"]
    joint = {name: information(u)[1] for name, u in experiments().items()}
    assert joint["design, friction unknown"] == max(joint.values())


def test_ties_go_to_the_input_nearest_to_the_nominal_design_and_masses_settle() -> None:
    """Without the rule, the pulse of the design for the larger mass began one interval earlier."""
    nominal, large = designed(), designed(1.2 * CART.mass)
    first = [int(np.argmax(u > 1.0)) for u in (nominal, large)]
    assert first[0] == first[1]
    assert settling_time(CART.mass * np.array([1.1, 1.0, 1.0])) == pytest.approx(0.01)
    assert settling_time(CART.mass * np.array([1.0, np.nan])) == np.inf
    assert settling_time(CART.mass * np.ones(3)) == 0.0


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_same_seeds_same_page(tmp_path: Path) -> None:
    texts = []
    for processes in ("1", "2"):
        out = tmp_path / processes / "paper.md"
        out.parent.mkdir()
        assert (
            main(["--out", str(out), "--images", str(out.parent / "images"), "--seeds", "2", "--jobs", processes]) == 0
        )
        texts.append(out.read_text(encoding="utf-8"))
    assert texts[0] == texts[1]
