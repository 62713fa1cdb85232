"""
Do the error bars hold?
=======================

Sixty records of the same cart, each with another random input and another start on the encoder. About 95 of 100
intervals should contain the true mass.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, make_scenario

estimates, halves = [], []
for seed in range(60):
    run = make_scenario("prbs", seed=seed, increments=128, duration=20.0)
    iv = pmfid.IV(pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution), run.dt, cutoff=33.0)
    fit = iv.fit(run.motion.u, run.counts)
    estimates.append(fit["mass"])
    halves.append(1.96 * fit.theta_std[0])
mass, half = np.array(estimates), np.array(halves)
holds = np.abs(mass - CART.mass) < half
print(f"{holds.sum()} of {holds.size} intervals contain the true mass")

figure = Figure(figsize=(8, 3.6), layout="constrained")
axes = figure.subplots()
number = np.arange(holds.size)
for chosen, colour, label in ((holds, "C0", "contains the truth"), (~holds, "C3", "misses it")):
    if chosen.any():
        axes.errorbar(number[chosen], mass[chosen], half[chosen], fmt="o", ms=3, color=colour, label=label)
axes.axhline(CART.mass, color="k", ls="--", lw=1)
axes.set(xlabel="record", ylabel="mass [kg]")
axes.legend(ncols=2, loc="upper left")
