"""
A dead time that nobody mentioned
=================================

The force of this cart acts late. Left out of the model, the dead time moves the mass; estimated, it does not.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, CART_DT, Machine, drive_machine, prbs

u = prbs(3000, clock=8, amplitude=3.0, rng=np.random.default_rng(1))
encoder = pmfid.Encoder(91e-6)
delays = 1e-3 * np.arange(0, 21, 4)
left_out, estimated, found = [], [], []
for delay in delays:
    run = drive_machine(Machine(CART, dead_time=float(delay)), u, CART_DT, 91e-6)
    left_out.append(pmfid.IV(pmfid.Drive(2.0), encoder, CART_DT, 33.0).fit(run.u, run.counts)["mass"])
    fit = pmfid.MotionFit(pmfid.Drive(2.0, dead_time="estimate"), encoder, CART_DT, 33.0).fit(run.u, run.counts)
    estimated.append(fit["mass"])
    found.append(fit["dead_time"])
    print(f"{1000 * delay:4.0f} ms: left out {left_out[-1]:.3f} kg, estimated {estimated[-1]:.3f} kg")

figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2)
left.plot(1000 * delays, left_out, "s-", label="left out")
left.plot(1000 * delays, estimated, "o-", label="estimated")
left.axhline(CART.mass, color="k", ls="--", lw=1)
left.set(xlabel="true dead time [ms]", ylabel="mass [kg]")
left.legend()
right.plot(1000 * delays, 1000 * delays, "k--", lw=1)
right.plot(1000 * delays, 1000 * np.array(found), "C1o")
right.set(xlabel="true dead time [ms]", ylabel="estimated dead time [ms]")
