"""
The motion that tells most
==========================

A trapezoid is a usual motion for commissioning. Within the same limits of voltage, travel and time, a designed motion
tells more about the mass and the friction.
"""

from matplotlib.figure import Figure

import pmfid
from pmfid.design import Limits, Problem, evaluate, solve, standard_inputs

limits = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
nominal = {"mass": 1.07, "viscous_friction": 12.8, "coulomb_friction": 0.8}
problem = Problem(
    pmfid.Drive(2.0), nominal, ("mass", "viscous_friction", "coulomb_friction"), 2.0, 40, limits, resolution=91e-6
)
design = solve(problem, "D", starts=5, seed=0)
trapezoid = standard_inputs(problem)["trapezoid"]
usual = evaluate(problem, trapezoid.u, "D")
for name, planned in design.predicted_std.items():
    print(f"{name}: expected standard deviation {planned:.3g}, with the trapezoid {usual.predicted_std[name]:.3g}")

figure = Figure(figsize=(8, 4.4), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True)
for name, motion in {"design": design, "trapezoid": usual}.items():
    upper.step(motion.t[: motion.u.size], motion.u, where="post", label=name)
    lower.plot(motion.t[: motion.x.size], motion.x, label=name)
upper.set_ylabel("input [V]")
upper.legend(loc="upper right")
lower.set(xlabel="time [s]", ylabel="position [m]")
