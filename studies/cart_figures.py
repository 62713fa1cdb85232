"""The cart's figures in a minute: `python -m studies.cart_figures` prints them, 10 seeds of 30 s each.

Discretisation error without noise, bias at 256 increments, range of the on-line mass over a mass step, float32 against
float64; filter time constant 2 T, order 2, PRBS of 3 V.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.iv import IV
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.recursive import BCRLS
from pmfid.models.drive import Drive
from pmfid.simulation.drive import quantize, simulate_drive
from pmfid.simulation.scenarios import CART, CART_DT, make_scenario, resolution_of
from pmfid.simulation.signals import prbs

SEEDS, CUTOFF = 10, 50.0
DRIVE = Drive(CART.input_gain)
TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


def bias(cls: type[Estimator], resolution: float, clock: int, **options: Any) -> NDArray[np.float64]:
    """Mean error over the seeds of mass, viscous and Coulomb friction [%], (3,)."""
    found = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        u = prbs(3000, clock=clock, amplitude=3.0, rng=rng)
        phase = rng.uniform(0, resolution)
        counts = quantize(simulate_drive(CART, u, CART_DT).x, resolution, phase=phase)
        estimator: Any = cls(DRIVE, Encoder(resolution), CART_DT, CUTOFF, **options)
        whole = isinstance(estimator, BatchEstimator)
        theta = estimator.fit(u, counts).theta if whole else estimator.run(u, counts).theta[-1]
        found.append(theta[:3])
    return np.asarray(100 * (np.mean(found, axis=0) / TRUTH - 1))


def track(seed: int, increments: int, precision: str) -> NDArray[np.float64]:
    """BCRLS over the mass step from 1 s on, forgetting 0.99: theta (n, 3)."""
    scenario = make_scenario("mass-step", seed=seed, increments=increments)
    estimator = BCRLS(DRIVE, Encoder(scenario.resolution), CART_DT, CUTOFF, forgetting=0.99, precision=precision)
    return estimator.run(scenario.motion.u, scenario.counts).theta[100:]


def main() -> None:
    """Prints the figures."""
    coarse, zeros = resolution_of(256), {"prefilter_zeros": (-2.0, -5.0)}
    for clock in (10, 3):
        print(f"clock {clock} samples; errors of mass, viscous, Coulomb in percent")
        print("  no noise, LS matched     ", bias(LS, 1e-9, clock).round(3))
        print("  no noise, LS paper       ", bias(LS, 1e-9, clock, discretization="paper").round(3))
        print("  no noise, IV             ", bias(IV, 1e-9, clock).round(3))
        for cls in (LS, BCLS, BCRLS, IV):
            print(f"  256 increments, {cls.__name__:9}", bias(cls, coarse, clock).round(3))
        print("  256 increments, extended LS", bias(LS, coarse, clock, **zeros).round(3))
    tracks = {n: [track(seed, n, "float64") for seed in range(SEEDS)] for n in (4096, 1024, 512, 256)}
    mass = np.concatenate([theta[:, 0] for runs in tracks.values() for theta in runs])
    print(f"BCRLS over the mass step, all encoders, from 1 s on: {mass.min():.3f} to {mass.max():.3f} kg")
    apart = max(float(np.max(np.abs(track(0, n, "float32") / tracks[n][0] - 1))) for n in tracks)
    print(f"float32 against float64: {apart:.2g}")


if __name__ == "__main__":
    main()
