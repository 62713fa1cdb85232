"""
One motion, seven encoders
==========================

The same motion is seen by encoders of 4096 to 16 counts per turn. Least squares loses the mass; instrumental variables
and the likelihood of the counts keep it.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, make_scenario

increments = [4096, 1024, 256, 128, 64, 32, 16]
methods = {
    "least squares": pmfid.LS,
    "compensated": pmfid.BCLS,
    "instruments": pmfid.IV,
    "likelihood": pmfid.MotionFit,
}
errors: dict[str, list[float]] = {name: [] for name in methods}
for count in increments:
    run = make_scenario("multisine", seed=3, increments=count)
    for name, method in methods.items():
        estimator = method(pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution), run.dt, cutoff=33.0)
        try:
            mass = estimator.fit(run.motion.u, run.counts)["mass"]
        except pmfid.NotIdentifiableError:
            mass = np.nan
        errors[name].append(100 * abs(mass / CART.mass - 1))

for name, row in errors.items():
    print(f"{name:15}", " ".join(f"{error:8.3f} %" for error in row))

figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.subplots()
for (name, row), mark in zip(errors.items(), "s^ov", strict=True):
    axes.plot(increments, row, marker=mark, label=name)
axes.axhline(1, color="0.6", lw=1, ls="--")
axes.set(xscale="log", yscale="log", xlabel="counts per turn", ylabel="error of the mass [%]")
axes.set_xticks(increments, [str(count) for count in increments])
axes.minorticks_off()
axes.legend()
