"""
A process with a sensor of five levels
======================================

The sensor of this process knows five levels, and every seventh sample is missing. Poles, gain and step response
still come out, each with its uncertainty.
"""

import numpy as np
from matplotlib.figure import Figure

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.simulation.process import PLANTS

plant = PLANTS["second-order"]  # 3 / (s^2 + 4 s + 3)
step = float(np.ptp(plant.y)) / 4
seen = step * np.floor(plant.y / step + 0.5)
seen[::7] = np.nan
estimator = SRIVC(TransferFunction(n=2, m=0), Encoder(1.0), plant.dt, cutoff=5.0)
process = estimator.fit_experiments([Experiment(plant.u, seen, dt=plant.dt)]).process
print(process)
print(f"gain {process.gain:.3f} ± {process.gain_std:.3f}; the truth is 1")

figure = Figure(figsize=(8, 3), layout="constrained")
axes = figure.subplots()
part = slice(0, 300)
t = plant.dt * np.arange(plant.samples)
axes.plot(t[part], plant.y[part], label="true output")
axes.plot(t[part], seen[part], ".", ms=4, label="what the sensor shows")
axes.set(xlabel="time [s]", ylabel="output")
axes.legend(loc="upper right")

# %%
# The step response with its 95 % band:

response = process.plot()
