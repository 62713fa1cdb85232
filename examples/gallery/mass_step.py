"""
Follow a load while it changes
==============================

A cart gets a load half-way through the run. Its encoder has 256 counts per turn. The estimate runs sample by sample.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import make_scenario

run = make_scenario("stop-and-go-mass-step", seed=0, increments=256, duration=60.0)
riv = pmfid.RIV(pmfid.Drive(input_gain=2.0), pmfid.Encoder(run.resolution), run.dt, cutoff=33.0, forgetting=0.995)
track = riv.run(run.motion.u, run.counts)

mass, deviation = track["mass"], track.theta_std[:, 0]
valid = (track.status & pmfid.Status.NOT_AN_ESTIMATE) == 0
print(f"before {mass[2900]:.3f} kg, at the end {mass[-1]:.3f} kg; the truth is 1.07 and 1.44 kg")

figure = Figure(figsize=(8, 4.2), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
low, high = mass - 2 * deviation, mass + 2 * deviation
upper.fill_between(run.motion.t, low, high, where=valid, alpha=0.3, label="two standard errors")
upper.plot(run.motion.t, np.where(valid, mass, np.nan), label="estimate")
upper.step([0, 30, 60], [1.07, 1.44, 1.44], where="post", color="k", ls="--", lw=1, label="truth")
upper.set(ylabel="mass [kg]", ylim=(0.9, 1.6))
upper.legend(ncols=3, loc="upper left")
lower.plot(run.motion.t, run.counts, lw=0.8)
lower.set(xlabel="time [s]", ylabel="counts")
