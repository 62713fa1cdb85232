"""EMPS by the official protocol: estimate from one record, and simulate another one from its first 20 samples.

`python -m studies.free_run_emps [--test RECORD.mat]`. Without another record, the first half of the record gives the
parameters, and the second half is simulated. Errors of the position are root mean squares in mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import suppress
from itertools import product
from pathlib import Path

import numpy as np

from pmfid import IV, LS, Drive, Encoder, MotionFit
from pmfid.diagnostics.free_run import FreeRun, drive_run
from pmfid.errors import UsageError
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.solve import solve
from pmfid.types import Counts, Floats
from studies.record_parts import EMPS, EMPS_DT

RESOLUTION = 5e-8  # of the positions [m]
MODELS: Mapping[str, Drive] = {
    "offset": Drive(1.0, offset=True),
    "directional": Drive(1.0, friction="directional"),
    "offset, quadratic": Drive(1.0, offset=True, quadratic=True),
}
Part = tuple[Floats, Counts]


def read_part(path: Path) -> Part:
    """Return the force [N] and the counts, each (n,)."""
    from scipy.io import loadmat

    data = loadmat(path)
    return (data["vir"] * data["gtau"]).ravel(), np.rint(data["qm"].ravel() / RESOLUTION).astype(np.int64)


def estimate(method: str, model: Drive, part: Part) -> Floats:
    """Return the parameters (p,) by a method of the package at 100 rad/s, or by the simulated position."""
    if method == "position":
        return fit_position(model, part)
    cls = {"ls": LS, "iv": IV, "fit": MotionFit}[method]
    return np.asarray(cls(model, Encoder(RESOLUTION), EMPS_DT, 100.0).fit(*part).theta)


def fit_position(model: Drive, part: Part) -> Floats:
    """Return the parameters (p,) of least squares of the simulated position, from those of `iv`."""
    problem = MotionFit(model, Encoder(RESOLUTION), EMPS_DT, 100.0).problem(*part)
    q, start = problem.start(estimate("iv", model, part)), problem.first_starts()
    noise = Gaussian(problem.stretches, scale=12 * (1e-3 / RESOLUTION) ** 2)  # errors of 1 mm
    return problem.theta(solve(problem, noise, q, start, np.zeros(q.size), 60, 1e-6).q)


def predict(model: Drive, theta: Floats, part: Part) -> FreeRun:
    """Return the free run over a part, from its first 20 samples, of which no motion explains every count."""
    return drive_run(MotionFit(model, Encoder(RESOLUTION), EMPS_DT, 50.0), theta, *part, "test")


def write_table(train: Part, test: Part) -> None:
    """Print a row for each model and method."""
    print("| model | method | parameters | train [mm] | test [mm] | every 1, 2, 5 s [mm] |\n" + "|---" * 6 + "|")
    for (name, model), method in product(MODELS.items(), ("ls", "iv", "position", "fit")):
        with suppress(UsageError):
            theta = estimate(method, model, train)
            runs = [predict(model, theta, part) for part in (train, test)]
            numbers = " | ".join(f"{1e3 * run.rmse:.2f}" for run in runs)
            again = ", ".join(f"{1e3 * horizon.rmse:.2f}" for horizon in runs[1].horizons[:3])
            values = " ".join(f"{value:.4g}" for value in theta)
            print(f"| {name} | {method} | {values} | {numbers} | {again} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=EMPS)
    parser.add_argument("--test", type=Path, help="another record")
    options = parser.parse_args()
    force, counts = read_part(options.data)
    half = slice(None) if options.test else slice(force.size // 2)
    rest = slice(force.size // 2, None)
    write_table((force[half], counts[half]), read_part(options.test) if options.test else (force[rest], counts[rest]))
