"""
What is missing in the model?
=============================

A linear motor has cogging, and its model has none. The residual shows a pattern over the position; the right term
removes it.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, CART_DT, Machine, drive_machine, prbs

pitch, step = 0.03, 22.75e-6
u = prbs(3000, clock=10, amplitude=3.0, rng=np.random.default_rng(4))
run = drive_machine(Machine(CART, cogging=0.6, cogging_pitch=pitch), u, CART_DT, step)
encoder = pmfid.Encoder(step)
drives = {"no cogging": pmfid.Drive(2.0), "cogging": pmfid.Drive(2.0, cogging=pitch)}

figure = Figure(figsize=(8, 3.4), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, (name, drive) in zip(panels, drives.items(), strict=True):
    result = pmfid.identify(run.u, run.counts, model=drive, encoder=encoder, dt=CART_DT, method="iv", cutoff=33.0)
    print(f"model with {name}: mass {result['mass']:.4f} kg, status {', '.join(result.status) or 'none'}")
    residual = pmfid.IV(drive, encoder, CART_DT, cutoff=33.0).fit(run.u, run.counts).residual
    place = 1000 * ((step * run.counts[-residual.size :]) % pitch)
    axes.plot(place, residual, ".", ms=2, alpha=0.5, rasterized=True)
    axes.set(title=f"model with {name}", xlabel="position within the pitch [mm]")
panels[0].set_ylabel("residual force [N]")
