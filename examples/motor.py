"""Print the log of a simulated motor: `python examples/motor.py SEED`.

The disc of its encoder, 4096 counts a turn, is off the axis by 0.3 % of a turn. Coulomb friction falls by 1.5 % per
degree, and the bearing warms up and cools down. Columns: time [s], torque [N m], counts, temperature [degree C].
"""

import math
import random
import sys

INERTIA, VISCOUS, COULOMB, SLOPE = 2e-4, 1.5e-3, 0.012, -0.015
COUNTS, ERROR, PHASE = 4096, 0.003 * 2 * math.pi, 0.7
STEP, SAMPLES, SUBSTEPS, HOLD, PEAK = 0.001, 5000, 40, 25, 0.1


def main(seed: int) -> None:
    chance, torque, x, v, h = random.Random(seed), 0.0, 0.0, 0.0, STEP / SUBSTEPS
    print("t,torque,counts,temp")
    for k in range(SAMPLES):
        torque = chance.uniform(-PEAK, PEAK) if k % HOLD == 0 else torque
        warmth = 10 * math.sin(2 * math.pi * k / 3500) ** 2
        coulomb = COULOMB * (1 + SLOPE * warmth)
        counts = math.floor((x + ERROR * math.sin(x + PHASE)) / (2 * math.pi) * COUNTS)
        print(f"{k * STEP:.3f},{torque:.6f},{counts},{25 + warmth:.1f}")
        for _ in range(SUBSTEPS):
            free = (v + h * torque / INERTIA) / (1 + h * VISCOUS / INERTIA)
            before, v = v, math.copysign(max(abs(free) - h * coulomb / INERTIA, 0.0), free)
            x += h / 2 * (before + v)


main(int(sys.argv[1]))
