"""
Two hundred axes in one call
============================

Two hundred carts of one kind, three of them with a heavier load. All estimates come from one call, each with the bits
that it would have alone.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, Schedule, make_scenario

rng = np.random.default_rng(5)
loads = CART.mass * (1 + 0.01 * rng.standard_normal(200))
loads[[20, 77, 150]] += [0.12, 0.2, 0.3]
runs = [
    make_scenario("moves", seed=k, increments=512, duration=15.0, schedule=Schedule(((0.0, replace(CART, mass=load)),)))
    for k, load in enumerate(loads.tolist())
]
riv = pmfid.RIV(pmfid.Drive(CART.input_gain), pmfid.Encoder(runs[0].resolution), runs[0].dt, 33.0)
tracks = pmfid.Fleet(riv, len(runs)).run([run.motion.u for run in runs], [run.counts for run in runs])
mass = tracks["mass"][:, -1]
print(f"heaviest axes: {sorted(np.argsort(mass)[-3:].tolist())}; median error {np.median(np.abs(mass - loads)):.4f} kg")

figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2, sharey=True, width_ratios=[3, 1])
left.plot(mass, "o", ms=3, label="estimate")
left.plot(loads, "k_", ms=6, label="truth")
left.set(xlabel="axis", ylabel="mass [kg]")
left.legend(loc="upper left")
right.hist(mass, bins=30, orientation="horizontal")
right.set(xlabel="axes")
