"""What a real axis has: an eccentric encoder, and friction that follows a temperature."""

from __future__ import annotations

import re

import numpy as np
import pytest

import pmfid
from pmfid.types import Floats
from studies.referee.cases import make_cases
from studies.referee.judge import fit_plain
from tests.oracles.axis import Axes, Excitation, simulate_axes


@pytest.mark.parametrize("index", [0, 5, pytest.param(9, marks=pytest.mark.long)])
def test_an_eccentric_encoder_is_named_with_amplitude_and_phase(index: int) -> None:
    """Without the row of the table, the mass is off, or another wave is named. Case 5 covers a tenth of a turn."""
    result = fit_plain(case := make_cases(5, "eccentric encoder", [index])[0])
    assert result.interval_95 is not None
    assert result.interval_95[0, 0] <= case.truth["mass"] <= result.interval_95[0, 1]
    (named,) = [one.sentence for one in result.findings if "once a turn" in one.sentence]
    shown = re.findall(r"of (\S+) ± (\S+) rad with a phase of (\S+) ± (\S+) deg", named)
    size, error, phase, across = map(float, shown[0])
    assert abs(size - case.facts["eccentricity"] * case.resolution) < 3 * error + 5e-4 * size
    assert abs((phase - np.degrees(case.facts["phase"]) + 180) % 360 - 180) < 3 * across + 0.05


def warm_axis(seed: int, n: int = 1000) -> tuple[dict[str, Floats], float]:
    """Return columns of an axis whose Coulomb friction falls by 0.02 N/K, from 0.8 N at 30 degrees, and the mean
    temperature."""
    rng, dt, resolution = np.random.default_rng(seed), 0.01, 1e-4
    hot = 30 + 10 * np.sin(np.arange(n) * 2 * np.pi / 900) + 3 * np.sin(np.arange(n) / 40)
    u = np.repeat(rng.uniform(-6, 6, n // 10), 10)
    axes = Axes(mass=1.07 * resolution / dt**2, viscous=12.8 * resolution / dt, coulomb=0.8)
    none, zero = np.zeros((n, 1)), np.zeros(1)
    drive = Excitation(
        u[:, None], none + 1, none, zero, zero, np.ones(1, np.intp), zero + 10, none, (1 - 0.025 * (hot - 30))[:, None]
    )
    counts = simulate_axes(axes, drive, zero + 0.3).counts[:, 0]
    sensor = np.where(np.arange(n) % 7 == 0, np.nan, hot)
    return {"t": dt * np.arange(n), "u": u, "counts": counts, "temp": sensor}, float(np.mean(hot))


def test_friction_follows_a_temperature() -> None:
    columns, mean = warm_axis(1)
    record = {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"}
    axis: dict[str, dict[str, object]] = {
        "record": record,
        "encoder": {"resolution": 1e-4},
        "model": {"input_gain": 1.0},
    }
    cold = pmfid.identify(columns, axis=axis)
    warm = pmfid.identify(columns, axis=axis | {"record": record | {"friction_temperature": "temp"}})
    assert warm.interval_95 is not None
    assert warm.status == ()
    for name, true in (("mass", 1.07), ("viscous_friction", 12.8), ("coulomb_friction", 0.8 - 0.02 * (mean - 30))):
        low, high = warm.interval_95[warm.names.index(name)]
        assert low <= true <= high
        assert high - low < 0.02 * true
    (sentence,) = [one.sentence for one in warm.findings if "friction_temperature" in one.sentence]
    slope, error = map(float, re.findall(r"by (\S+) ± (\S+) N", sentence)[0])
    assert abs(slope + 0.02) < 3 * error < 0.002
    assert warm.theta_std[2] < 0.5 * cold.theta_std[2]
