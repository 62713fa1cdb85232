"""Print the log of a simulated belt axis: `python examples/belt.py SEED [GAP]`.

A motor of 2e-4 kg m2 drives a load of 3e-4 kg m2 through a belt, whose resonance is at 31 Hz. The encoder on the motor
has 4096 counts a turn. With a GAP [counts], gears replace the belt: they touch stiffly, and play within the gap.
Columns: time [s], torque [N m], counts.
"""

import math
import random
import sys

MOTOR, LOAD, RESONANCE, DAMPING_RATIO = 2e-4, 3e-4, 31.0, 0.03
VISCOUS, COULOMB = (4e-4, 6e-4), (0.01, 0.015)  # of motor and load
STEP, SAMPLES, SUBSTEPS, HOLD, PEAK = 0.001, 4000, 200, 12, 0.15

GEARS = (150.0, 0.3)  # resonance and damping ratio of the contact
REDUCED = MOTOR * LOAD / (MOTOR + LOAD)


def kick(speed: float, force: float, inertia: float, viscous: float, coulomb: float, h: float) -> float:
    """Return the speed after h seconds. Coulomb friction slows the mass down to standstill at most."""
    free = (speed + h * force / inertia) / (1 + h * viscous / inertia)
    return math.copysign(max(abs(free) - h * coulomb / inertia, 0.0), free)


def main(seed: int, gap: float) -> None:
    resonance, ratio = GEARS if gap else (RESONANCE, DAMPING_RATIO)
    rate, half = 2 * math.pi * resonance, gap * math.pi / 4096
    stiffness, damping = REDUCED * rate**2, 2 * ratio * REDUCED * rate
    chance, torque = random.Random(seed), 0.0
    x, v, x2, v2 = 0.0, 0.0, 0.0, 0.0
    h = STEP / SUBSTEPS
    print("t,torque,counts")
    for k in range(SAMPLES):
        torque = chance.uniform(-PEAK, PEAK) if k % HOLD == 0 else torque
        print(f"{k * STEP:.3f},{torque:.6f},{math.floor(x / (2 * math.pi) * 4096)}")
        for _ in range(SUBSTEPS):
            x, x2 = x + h / 2 * v, x2 + h / 2 * v2
            twist = x - x2 - min(max(x - x2, -half), half)
            belt = stiffness * twist + damping * (v - v2) if twist or not gap else 0.0
            v = kick(v, torque - belt, MOTOR, VISCOUS[0], COULOMB[0], h)
            v2 = kick(v2, belt, LOAD, VISCOUS[1], COULOMB[1], h)
            x, x2 = x + h / 2 * v, x2 + h / 2 * v2


main(int(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.0)
