"""
An estimator and a plant of your own
====================================

The plant is of third order, and its sensor knows eight levels. The estimator is new: past values of the filtered input
serve as instruments, because they carry no noise of the sensor. It competes with the methods of pmfid over ten runs.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

from pmfid import BCLS, LS, SRIVC, Encoder, TransferFunction
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.results import Columns
from pmfid.simulation import prbs
from pmfid.simulation.process import simulate_process
from pmfid.testing import check_estimator
from pmfid.types import Floats


@dataclass(frozen=True)
class PastInput(BatchEstimator):
    """Instruments from the filtered input, each `delay` samples later than the one before."""

    method: ClassVar[str] = "past-input"
    delay: int = 10

    def _solve(self, columns: Columns) -> tuple[Floats, Floats]:
        first, last = 3 * self.delay, len(columns.z)
        phi, z, u = columns.phi[first:], columns.z[first:], columns.phi[:, -1]
        zeta = np.column_stack([u[first - i * self.delay : last - i * self.delay] for i in range(4)])
        inverse = np.linalg.inv(zeta.T @ phi)
        return inverse @ (zeta.T @ z), inverse @ (zeta.T @ zeta) @ inverse.T


# %%
# y''' + 4.4 y'' + 17.4 y' + 15 y = 15 u, sampled every 50 ms. The contract of estimators holds for the new one:

PLANT, DT, MODEL = ((15.0,), (1.0, 4.4, 17.4, 15.0)), 0.05, TransferFunction(n=3, m=0)
check_estimator(PastInput(MODEL, Encoder(1e-4), DT, cutoff=5.0))

METHODS = (LS, BCLS, SRIVC, PastInput)
estimates: dict[str, list[float]] = {cls.__name__: [] for cls in METHODS}
for seed in range(10):
    u = prbs(3000, clock=8, amplitude=1.0, rng=np.random.default_rng(seed))
    y = simulate_process(*PLANT, u, DT)
    step = float(np.ptp(y)) / 8
    counts = np.floor(y / step).astype(int)
    for cls in METHODS:
        estimates[cls.__name__].append(cls(MODEL, Encoder(step), DT, cutoff=5.0).fit(u, counts)["a2"])
for name, values in estimates.items():
    print(f"{name:10} a2 = {np.mean(values):.2f} ± {np.std(values):.2f}; the truth is 4.40")

figure = Figure(figsize=(8, 2.6), layout="constrained")
axes = figure.subplots()
for row, values in enumerate(estimates.values()):
    axes.plot(values, np.full(len(values), row), "o", ms=4)
axes.set_yticks(range(len(estimates)), list(estimates))
axes.invert_yaxis()
axes.axvline(4.4, color="#CC0099", ls="--")
axes.set_xlabel("a2 [1/s], ten runs; dashed: truth")
