"""Two masses with play: the body against an independent integrator, its derivatives, and the fit."""

from __future__ import annotations

import re

import numpy as np
import pytest

import pmfid
from pmfid._body import BASE, ELASTIC_BASE, run
from pmfid.pipeline.arrays import search_terms
from pmfid.types import Counts, Floats
from tests.oracles.two_mass import TwoMasses, simulate_two_masses

pytestmark = pytest.mark.usefixtures("without_judgement")

STEP = 0.002
RNG = np.random.default_rng(5)
INPUT = np.ascontiguousarray(RNG.uniform(-1, 1, 40).repeat(8))
#: Motor, its friction, load and its friction, and a contact that swings at 50 Hz.
PAIR, GAP, RESOLUTION = (0.5, 0.5, 0.1, 0.4, 0.3, 0.1, 22000.0, 40.0), 2e-4, 2e-5


def simulate(theta: Floats, u: Floats = INPUT) -> tuple[Floats, Floats]:
    row, clock = np.arange(u.size + 1, dtype=np.int32), np.full(u.size, STEP)
    y, _, S, rows = run([], clock, u, row, np.zeros((0, u.size)), theta, 2, np.eye(theta.size), elastic=True)
    assert rows == u.size + 1
    return y, S


def body() -> Floats:
    theta = np.zeros(ELASTIC_BASE)
    theta[[0, 1, 2, *range(BASE, BASE + 5)]] = PAIR
    theta[[BASE + 5, BASE + 7]] = 3e-5, GAP
    return theta


def test_the_motion_is_that_of_an_independent_integrator() -> None:
    truth = simulate_two_masses(TwoMasses(*PAIR, gap=GAP), INPUT, STEP, np.array([0.0, 0.0, 3e-5, 0.0]), 20)
    assert np.max(np.abs(simulate(body())[0] - truth[:, 0])) < 1e-7 * np.ptp(truth[:, 0])


def test_the_derivatives_are_those_of_the_motion() -> None:
    theta = body()
    slopes = simulate(theta)[1]
    for index in [0, 1, 2, 3, *range(BASE, BASE + 5), BASE + 7]:
        step = np.zeros(theta.size)
        step[index] = 1e-7 * max(abs(theta[index]), 1e-3)
        quotient = (simulate(theta + step)[0] - simulate(theta - step)[0]) / (2 * step[index])
        assert np.max(np.abs(quotient - slopes[:, index])) < 1e-3 * np.max(np.abs(quotient)), index


def record(gap: float, seed: int = 4) -> tuple[Floats, Counts]:
    u = np.random.default_rng(seed).uniform(-1, 1, 60).repeat(12)
    y = simulate_two_masses(TwoMasses(*PAIR, gap=gap), u[:-1], STEP, np.zeros(4), 20)[:, 0]
    return u, np.floor(y / RESOLUTION + 0.4).astype(np.int64)


def identify(gap: float) -> pmfid.Result:
    drive = pmfid.Drive(1.0, body="two-mass", play=True)
    return pmfid.identify(*record(gap), model=drive, dt=STEP, encoder=pmfid.Encoder(RESOLUTION))


def test_no_gap_is_not_determined() -> None:
    result = identify(0.0)
    assert "uncertain" in result.status
    assert "the error of play may exceed half its value" in [one.sentence for one in result.findings]


def test_the_gap_is_found_within_a_part_of_a_count() -> None:
    result = identify(GAP)
    assert result.names[-3:] == ("stiffness", "damping", "play")
    assert result["play"] == pytest.approx(GAP, abs=0.05 * RESOLUTION)
    half = np.diff(result.interval_95)[:, 0] / 2
    assert np.all(np.abs(result.theta - (*PAIR, GAP)) < 1.6 * half)  # nine parameters within three standard errors
    assert half[-1] < 0.25 * RESOLUTION


def test_a_rigid_axis_names_the_gap_and_the_search_for_terms_adds_it() -> None:
    u, counts = record(GAP, 10)
    found = search_terms(u, counts, model=pmfid.Drive(1.0), dt=STEP, encoder=pmfid.Encoder(RESOLUTION))
    assert found.added == {"body": "two-mass", "play": True}
    assert found.result["play"] == pytest.approx(GAP, abs=0.5 * RESOLUTION)
    (words,) = [row.words for row in found.rows if row.remedy.startswith('set body = "two-mass" and play = true in')]
    gap, error = map(float, re.findall(r"a gap of (\S+) ± (\S+) m", words)[0])
    assert abs(gap - GAP) < 3 * error < RESOLUTION
