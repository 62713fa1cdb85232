"""The record of all benchmarks, and the description of the machine in the results."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pmfid
from pmfid.simulation.scenarios import CART, make_scenario

SAMPLES = 200_000
CUTOFF = 50.0
FORGETTING = 0.999
PACKAGES = ("pmfid", "numpy", "scipy", "padasip", "statsmodels", "sippy_unipi")

DRIVE = pmfid.Drive(input_gain=CART.input_gain)


@dataclass(frozen=True, eq=False)
class Record:
    """The cart under a random binary input of 3 V, 1024 increments per turn: u [V] and counts (n,), dt [s].

    phi (m, 3) and z (m,) are its filtered regressors and target, for peers without filters. extended (m, 5) and
    extended_z (m,) belong to the model extended by the pre-filter (paper eq. 19 to 21).
    """

    u: NDArray[np.float64]
    counts: NDArray[np.int64]
    encoder: pmfid.Encoder
    dt: float
    phi: NDArray[np.float64]
    z: NDArray[np.float64]
    extended: NDArray[np.float64]
    extended_z: NDArray[np.float64]
    zeros: tuple[float, ...]


@pytest.fixture(scope="session")
def record() -> Record:
    run = make_scenario("prbs", seed=1, increments=1024, duration=SAMPLES * 0.01)
    encoder, u = pmfid.Encoder(run.resolution), run.motion.u
    zeros = pmfid.BCRLS(DRIVE, encoder, run.dt, CUTOFF).zeros
    plain = pmfid.LS(DRIVE, encoder, run.dt, CUTOFF).columns(u, run.counts)
    extended = pmfid.LS(DRIVE, encoder, run.dt, CUTOFF, prefilter_zeros=zeros).columns(u, run.counts)
    return Record(u, run.counts, encoder, run.dt, plain.phi, plain.z, extended.phi, extended.z, zeros)


def pytest_benchmark_update_machine_info(config: pytest.Config, machine_info: dict[str, Any]) -> None:
    """Add the versions of pmfid and its peers to the machine's description in the JSON file."""
    machine_info["packages"] = {name: version(name) for name in PACKAGES if find_spec(name)}
    machine_info["processors"] = os.cpu_count()
