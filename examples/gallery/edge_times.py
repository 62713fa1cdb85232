"""
Sixteen lines and a timer
=========================

An encoder of 16 counts per turn sees this cart in steps of 6 mm. A timer captures the age of the last edge, and the
position is known exactly at each edge.
"""

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, CART_DT, capture_edges, prbs, simulate_drive

step = 93.2e-3 / 16  # m per count
fine = 20  # steps of the simulation per sample
drive, encoder = pmfid.Drive(CART.input_gain), pmfid.Encoder(step)
rows: dict[str, list[float]] = {"counts alone": [], "with edge times": []}
for seed in range(5):
    u = prbs(3000, clock=8, amplitude=3.0, rng=np.random.default_rng(seed))
    motion = simulate_drive(CART, np.repeat(u, fine), CART_DT / fine)
    counts, ages = capture_edges(motion, step, every=fine, tick=1e-6)
    rows["counts alone"].append(pmfid.MotionFit(drive, encoder, CART_DT, 20.0).fit(u, counts)["mass"])
    edges = pmfid.EdgeFit(drive, encoder, CART_DT, 20.0, lines=16, tick=1e-6)
    rows["with edge times"].append(edges.fit(u, counts, ages)["mass"])
for name, masses in rows.items():
    print(f"{name}: largest error {100 * np.max(np.abs(np.array(masses) / CART.mass - 1)):.4f} %")

figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[2, 1])
part = slice(300, 400)
t = CART_DT * np.arange(part.start, part.stop)
seen = part.start + np.flatnonzero(np.isfinite(ages[part]))
left.step(t, 1000 * step * counts[part], where="post", label="counts")
left.plot(t, 1000 * motion.x[::fine][part], "k--", lw=1, label="true position")
lines = 1000 * step * np.maximum(counts[seen], counts[seen - 1])
left.plot(CART_DT * seen - ages[seen], lines, "o", ms=5, label="edges")
left.set(xlabel="time [s]", ylabel="position [mm]")
left.legend()
for place, (name, masses) in enumerate(rows.items()):
    right.plot(np.full(5, place), masses, "o", label=name)
right.axhline(CART.mass, color="k", ls="--", lw=1)
right.set_xticks([0, 1], ["counts", "edges"])
right.set(ylabel="mass [kg]", xlim=(-0.5, 1.5))
