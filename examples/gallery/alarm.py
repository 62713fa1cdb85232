"""
An alarm with its cause
=======================

A monitor knows normal work. It names the parameter that has changed, by how much, and since when.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.monitor.calibration import calibrate
from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import CART, make_scenario

normal = make_scenario("moves", seed=1, increments=1024, duration=300.0)
today = make_scenario("moves-mass-step", seed=2, increments=1024, duration=120.0)
drive, encoder = pmfid.Drive(CART.input_gain), pmfid.Encoder(normal.resolution)
nominal = {"mass": CART.mass, "viscous_friction": CART.viscous_friction, "coulomb_friction": CART.coulomb_friction}
riv = pmfid.RIV(drive, encoder, normal.dt, cutoff=33.0, forgetting=0.995, initial=nominal)
theta = np.array(list(nominal.values()))
monitor = Monitor(riv, calibrate(riv, theta, normal.motion.u, None), Watch(mtbf_hours=24.0, tolerance=0.02))

mass, statistic = [], []
for u, count in zip(today.motion.u.tolist(), today.counts.tolist(), strict=True):
    estimate, events = monitor.step(u, count)
    mass.append(estimate.theta[0])
    statistic.append(monitor.statistic)
    for event in events:
        if isinstance(event, Alarm):
            size = f"{100 * event.relative:+.1f} %, {event.change:+.3f} ± {event.std:.3f} {event.unit}"
            print(f"{event.time:.1f} s: {event.parameter} {size}, since {event.changed_at:.1f} s")

figure = Figure(figsize=(8, 4.2), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True)
upper.plot(today.motion.t, mass)
upper.axvline(60, color="k", ls="--", lw=1)
upper.set(ylabel="mass [kg]", ylim=(0.9, 1.6))
lower.semilogy(today.motion.t, np.maximum(statistic, 0.1))
lower.axhline(monitor.threshold, color="C3", ls="--", label="threshold")
lower.axvline(60, color="k", ls="--", lw=1, label="the load grows")
lower.set(xlabel="time [s]", ylabel="detector")
lower.legend()
