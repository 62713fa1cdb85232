"""The referee: its integrator against closed forms and a halved step, its machines, and its table."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from pmfid.types import Floats
from studies.referee import judge as judging
from studies.referee import machines
from studies.referee.cases import FAST, FAST_SUBSTEPS, PARAMETERS, SUBSTEPS, excite, make_cases
from studies.referee.judge import Answer, judge
from studies.referee.machines import KINDS, draw_machine
from tests.conftest import long_unless
from tests.oracles.axis import Axes, Excitation, Motion, simulate_axes


@pytest.fixture(autouse=True)
def shorten_records(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "SAMPLES", (200, 300))


def drive(axes: Axes, feed: Floats, substeps: int = 10) -> Motion:
    """Simulate one axis under a given input."""
    zeros, ones, none = np.zeros((feed.size, 1)), np.ones((feed.size, 1)), np.zeros(1)
    window, top = np.ones(1, np.intp), np.full(1, np.inf)
    excitation = Excitation(feed[:, None], ones, zeros, none, none, window, top, zeros, ones)
    return simulate_axes(axes, excitation, none, substeps)


def test_the_integrator_stops_inside_a_sample_as_the_closed_form_does() -> None:
    m, d, f = 5.0, 0.5, 0.3
    motion = drive(Axes(m, d, f), np.r_[np.ones(20), np.zeros(20)])
    v0 = (1 - f) / d * (1 - np.exp(-20 * d / m))
    stop = m / d * np.log(1 + v0 * d / f)
    t = np.minimum(np.arange(20), stop)
    x = m / d * (v0 + f / d) * (1 - np.exp(-t * d / m)) - f / d * t
    assert 3 < stop < 19
    np.testing.assert_allclose(motion.x[20:, 0] - motion.x[20, 0], x, rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion.v[20, 0], v0, rtol=1e-7)
    assert motion.v[-1, 0] == 0.0


@pytest.mark.parametrize("kind", long_unless(["backlash", "gravity", "lag", "Stribeck 50 %"].__contains__, KINDS))
def test_half_the_step_gives_the_same_motion(kind: str) -> None:
    axes = [draw_machine(3, kind, index) for index in range(7)]
    names = {name for machine in axes for name in machine.effect} - {"push", "friction"}
    values = {name: np.array([getattr(machine.pace, name) for machine in axes]) for name in PARAMETERS}
    values |= {name: np.array([machine.effect[name] for machine in axes]) for name in names}
    whole = excite(axes)
    short = {f.name: getattr(whole, f.name)[:80] for f in fields(whole) if getattr(whole, f.name).ndim == 2}
    substeps = FAST_SUBSTEPS if kind in FAST else SUBSTEPS
    start = np.array([machine.zero for machine in axes])
    coarse, fine = (simulate_axes(Axes(**values), replace(whole, **short), start, n) for n in (substeps, 2 * substeps))
    bound = 1e-2 if kind == "backlash" else 1e-5  # every impact amplifies a difference
    assert np.all(np.max(np.abs(coarse.x - fine.x), axis=0) <= bound * np.max(np.abs(fine.x), axis=0))


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_a_bent_input_leaves_the_gain_open(gain: float, monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_cases(5, "bending", [0])[0]
    bent, largest = draw_machine(5, "bending", 0), np.max(np.abs(case.u))
    assert np.unique(np.abs(case.u)).size == 1  # two levels
    assert case.seen_gain == pytest.approx(1 - bent.effect["bending"] * largest / bent.scale.top)
    case = replace(case, seen_gain=0.9)
    theta = {name: value / gain for name, value in case.truth.items()}
    monkeypatch.setattr(judging, "load_call", lambda _: lambda _: Answer(theta, theta, {}, (), ""))
    assert [judge("", case)[f"{name}_error"] for name in PARAMETERS] == pytest.approx([0.0] * 3)
