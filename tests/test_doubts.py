"""Transfer functions: refusals and findings for estimates whose numbers mislead."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid import Experiment
from pmfid.config.axis import load_axis
from pmfid.pipeline.processes import Processes
from pmfid.pipeline.result import ProcessResult
from pmfid.simulation.process import PLANTS
from tests.refusals import refused
from tests.test_process import CONFIG

PLANT = PLANTS["second-order"]


def identified(experiment: Experiment, **options: object) -> ProcessResult:
    settings = {key.replace("__", "."): value for key, value in options.items()}
    return Processes().estimate([experiment], load_axis(Path(CONFIG), settings))


def plain(y: np.ndarray) -> Experiment:
    return Experiment(PLANT.u, y, dt=PLANT.dt)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, 4))])
def test_noise_alone_is_no_process(n, seed):
    y = np.random.default_rng(seed).standard_normal(PLANT.samples)
    with pytest.raises(pmfid.NotIdentifiableError):
        identified(plain(y), model__n=n)


def test_an_unstable_process_is_named():
    """The process is 1/(s - 1) under proportional control."""
    rng, n, dt = np.random.default_rng(2), 2000, 0.02
    r = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    u, y = np.zeros(n), np.zeros(n + 1)
    for k in range(n):
        u[k] = 4 * (r[k] - y[k])
        y[k + 1] = np.exp(dt) * y[k] + (np.exp(dt) - 1) * u[k]
    record = Experiment(u, y[:-1] + 1e-3 * rng.standard_normal(n), dt=dt, reference=r)
    refused((r"pole at \+.* use ls or bcls", lambda: identified(record, model__n=1)), kind=pmfid.NotIdentifiableError)
    found = identified(record, model__n=1, estimator__method="ls")
    assert found.process.poles.real == pytest.approx([1.0], rel=0.02)
    assert found.fit is None
    assert found.to_dict()["fit"] is None
    assert "unstable" in found.status
