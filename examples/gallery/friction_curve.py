"""
Friction without a law
======================

This machine has Stribeck friction: its friction falls as it starts to move, then rises with speed. The curve is
estimated from counts, and no law is assumed.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, CART_DT, Machine, drive_machine, multisine

stribeck, speed = 0.6, 0.1  # N, m/s
machine = Machine(CART, stribeck=stribeck, stribeck_speed=speed)
u = multisine(6000, CART_DT, np.linspace(0.1, 2.0, 12), 3.0, np.random.default_rng(1))
run = drive_machine(machine, u, CART_DT, 1e-4)
curve = pmfid.friction_curve(
    run.u, run.counts, model=pmfid.Drive(CART.input_gain), encoder=pmfid.Encoder(1e-4), dt=CART_DT
)
for place, force, std in zip(curve.velocity[::40], curve.force[::40], curve.std[::40], strict=True):
    print(f"{place:+.3f} m/s: {force:+.3f} ± {std:.3f} N")

fast = np.linspace(0.002, np.max(curve.velocity), 300)
truth = CART.coulomb_friction + CART.viscous_friction * fast + stribeck * np.exp(-((fast / speed) ** 2))
figure = Figure(figsize=(8, 3.8), layout="constrained")
axes = figure.subplots()
for sign in (-1, 1):
    axes.plot(sign * fast, sign * truth, color="0.85", lw=8, label="truth" if sign > 0 else None)
    side = sign * curve.velocity > 0
    error = 2 * curve.std[side]
    v, force = curve.velocity[side], curve.force[side]
    axes.fill_between(v, force - error, force + error, color="C0", alpha=0.4)
    axes.plot(v, force, "C0", label="estimate" if sign > 0 else None)
axes.set(xlabel="velocity [m/s]", ylabel="friction [N]")
axes.legend()
