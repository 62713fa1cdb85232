"""Measured records that are not part of the project: EMPS, and a cart under relay current."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats

#: The electro-mechanical positioning system, 24 841 samples at 1 kHz (Janot, Gautier and Brunot 2019).
EMPS, EMPS_DT = Path(__file__).parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat", 1e-3
#: Logs of a cart under relay current: 150 Hz, travel per count [m], force per current [N/A].
CART, CART_DT, STEP, FORCE = EMPS.parents[1] / "real" / "cart_relay", 1 / 150, 8.8e-5, 3.3357


@dataclass(frozen=True, eq=False)
class Motion:
    """Input (n,), counts (n,), unit of the position per count, sample period [s]."""

    u: Floats
    counts: NDArray[np.int64]
    resolution: float
    dt: float


def measured(resolution: float) -> Motion:
    """Return the record of EMPS with the counts of an encoder."""
    from scipy.io import loadmat

    data = loadmat(EMPS)
    counts = np.floor(data["qm"].ravel() / resolution + 1e-6).astype(np.int64)
    return Motion((data["vir"] * data["gtau"]).ravel(), counts, resolution, EMPS_DT)


def cart_log(name: str) -> Motion:
    """Return a record on an even clock, without its first two rows."""
    time, current, position = np.loadtxt(CART / f"{name}.csv", delimiter=",", usecols=(0, 1, 2), skiprows=2).T
    even = np.arange(time[0], time[-1], CART_DT)
    last = np.searchsorted(time, even + CART_DT / 4) - 1
    return Motion(current[last], np.rint(position[last] / STEP).astype(np.int64), STEP, CART_DT)
