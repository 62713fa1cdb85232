"""The alarm of an export: the sums of its formula, an alarm after a change, and none before it or without motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import pmfid
from pmfid import Status
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.export.firmware import ParameterAlarm
from pmfid.simulation.scenarios import make_scenario
from tests.firmware.build import GCC, HERE, WARNINGS, compiled, run
from tests.firmware.replay import exported

pytestmark = pytest.mark.skipif(bool(GCC.missing), reason=GCC.missing)
ALARM = ParameterAlarm("mass", nominal=1.07, shift=0.1)
UNTRUSTED = Status.STARTING | Status.SETTLING | Status.POOR_EXCITATION | Status.RESET | Status.UNMODELLED


def watched(estimator: RecursiveEstimator, folder: Path, u: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray:
    """Return alarm, up and down after each sample, from the exported C."""
    exported(estimator, folder, u, counts)
    pmfid.export_firmware(estimator, folder / "c", alarms=[ALARM])
    program = compiled(folder / "c", "axis", GCC, HERE / "watch.c", "-O0", *WARNINGS)
    assert run(program, GCC, "../in.bin", "out.bin").returncode == 0
    real = np.float32 if estimator.precision == "float32" else np.float64
    dtype = np.dtype([("alarm", np.int32), ("up", real), ("down", real)], align=True)
    return np.frombuffer((folder / "c" / "out.bin").read_bytes(), dtype)


def oracle(estimator: RecursiveEstimator, u: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return up and down (n, 2): g = max(0, g + s (+-x - s / 2) / v), with one estimate in each `interval`."""
    track, interval = estimator.run(u, counts), ALARM.interval(estimator)
    variance = track.theta_std[:, 0] ** 2
    usable = ((track.status & UNTRUSTED) == 0) & np.isfinite(variance)
    sums, rows, wait = np.zeros(2), [], 0
    for theta, v, trusted in zip(track.theta[:, 0], variance, usable, strict=True):
        wait = min(wait + 1, interval)
        if trusted and wait >= interval:
            x = theta - ALARM.nominal
            sums = sums + ALARM.shift * (np.array([x, -x]) - ALARM.shift / 2) / v
            sums, wait = np.clip(sums, 0, 2 * ALARM.threshold), 0
        rows.append(sums)
    return np.array(rows)


def bcrls(resolution: float, precision: str) -> pmfid.BCRLS:
    encoder = pmfid.Encoder(resolution)
    return pmfid.BCRLS(pmfid.Drive(2.0), encoder, 0.01, 50.0, forgetting=0.99, precision=precision)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.long)])
def test_a_heavier_load_raises_the_alarm(precision: str, tmp_path: Path) -> None:
    scenario = make_scenario("mass-step", seed=3, increments=1024, duration=60.0)
    u, counts = scenario.motion.u, scenario.counts
    estimator = bcrls(scenario.resolution, precision)
    found, expected = watched(estimator, tmp_path, u, counts), oracle(estimator, u, counts)
    np.testing.assert_allclose(found["up"], expected[:, 0], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found["down"], expected[:, 1], rtol=1e-3, atol=1e-3)
    assert not np.any(found["alarm"][:3000]), "before the mass steps"
    after = np.flatnonzero(found["alarm"] == 1)
    assert 3000 < after[0] < 3800
    assert found["alarm"][-1] == 1


def test_standstill_raises_none(tmp_path: Path) -> None:
    scenario = make_scenario("standstill", seed=3, increments=1024, duration=60.0)
    found = watched(bcrls(scenario.resolution, "float32"), tmp_path, scenario.motion.u, scenario.counts)
    assert not np.any(found["alarm"])
