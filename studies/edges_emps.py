"""EMPS by the edges of a coarse encoder, against the published parameters and the counts alone.

`python -m studies.edges_emps [--data FOLDER] [--steps MM ...] [--phases N] [--directional]`. The edges come from the
record of 0.05 um. Each cell has the errors of mass, viscous and Coulomb friction in percent, as root mean squares over
the phases of the encoder.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path

import numpy as np

from pmfid import IV, Drive, EdgeFit, Encoder, MotionFit
from pmfid.edge_times import Lattice, Trajectory, read_edge_times
from pmfid.errors import NotIdentifiableError
from pmfid.types import Floats
from studies.record_parts import EMPS
from studies.record_parts import EMPS_DT as DT

#: Least squares of the authors on the whole record (Janot, Gautier and Brunot 2019).
PUBLISHED = {"symmetric, offset": np.array([95.1089, 203.5034, 20.3935, -3.1648])}

CUTOFF, START, TICK = 100.0, 500, 1e-6


def read_record(path: Path) -> tuple[Floats, Floats]:
    """Return the force [N] and the position [m], each (n,), without the start."""
    from scipy.io import loadmat

    data = loadmat(path)
    return (data["vir"] * data["gtau"]).ravel()[START:], data["qm"].ravel()[START:]


def compare(force: Floats, y: Floats, step: float, phase: float, friction: str) -> dict[str, Floats]:
    """Return the relative errors (p,) of each method."""
    model = Drive(1.0, friction="directional") if friction == "directional" else Drive(1.0, offset=True)
    counts, ages = read_edge_times(Trajectory.sample(y, DT), Lattice(step, phase * step, np.zeros(1)), tick=TICK)
    encoder = Encoder(step)
    methods: dict[str, EdgeFit | MotionFit | IV] = {
        "edges": EdgeFit(model, encoder, DT, CUTOFF, tick=TICK),
        "interval": MotionFit(model, encoder, DT, CUTOFF),
        "iv": IV(model, encoder, DT, 0.2 * CUTOFF),
    }
    found = {name: np.full(PUBLISHED[friction].size, np.nan) for name in methods}
    for name, method in methods.items():
        with suppress(NotIdentifiableError):
            fit = method.fit(force, counts, ages) if isinstance(method, EdgeFit) else method.fit(force, counts)
            found[name] = fit.theta / PUBLISHED[friction] - 1
    return found


def measure(path: Path, steps: list[float], phases: int, friction: str) -> None:
    """Print a row for each step of the encoder."""
    force, y = read_record(path)
    print("| step [mm] | edges [%] | interval [%] | iv [%] |")
    print("|---" * 4 + "|")
    for step in steps:
        runs = [compare(force, y, 1e-3 * step, (k + 0.5) / phases, friction) for k in range(phases)]
        cells = []
        for name in runs[0]:
            errors = np.array([run[name] for run in runs])[:, : 5 if friction == "directional" else 3]
            cells.append(" ".join(f"{value:.2f}" for value in 100 * np.sqrt(np.mean(errors**2, axis=0))))
        print(f"| {step:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=EMPS)
    parser.add_argument("--steps", type=float, nargs="+", default=[1.0, 2.0, 5.0, 10.0, 20.0], help="[mm]")
    parser.add_argument("--phases", type=int, default=4)
    parser.add_argument("--directional", action="store_true")
    options = parser.parse_args()
    friction = "directional" if options.directional else "symmetric, offset"
    measure(options.data, options.steps, options.phases, friction)
