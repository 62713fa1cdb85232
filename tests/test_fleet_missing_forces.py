"""The error bars of a history contain the errors by forces that its model lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from pmfid import fleet
from pmfid.fleet.missing_forces import model_error
from studies.referee.motions import MOTIONS, Pace
from tests.oracles.axis import Axes, Excitation, simulate_axes

#: Mass, viscous and Coulomb friction, in counts, samples and parts of the largest input.
MASS, VISCOUS, COULOMB = TRUE = np.array([0.12, 0.0024, 0.15])
SPEED = (1 - COULOMB) / VISCOUS
SAMPLES, DT, RESOLUTION = 6000, 0.02, 1e-5


def make_log(motion: str, seed: int, quadratic: float) -> pl.DataFrame:
    """Return the rows of an axis that moves by a motion of the referee."""
    rng = np.random.default_rng(seed)
    one = MOTIONS[motion](SAMPLES, Pace(MASS, VISCOUS, COULOMB, MASS / VISCOUS, 40, SPEED), rng)
    kp, kd, window = (np.array([value]) for value in (one.kp, one.kd, one.window))
    ones, inputs = np.ones((SAMPLES, 1)), (one.feed[:, None], one.reference[:, None])
    excitation = Excitation(inputs[0], ones, inputs[1], kp, kd, window, ones[0], 0 * ones, ones)
    machine = replace(Axes(MASS, VISCOUS, COULOMB), quadratic=np.array([quadratic]))
    moved = simulate_axes(machine, excitation, rng.random(1), substeps=2)
    rows = pl.DataFrame({"t": np.arange(SAMPLES) * DT, "u": moved.u[:, 0], "counts": moved.counts[:, 0]})
    return rows.with_columns(axis=pl.lit("a"))


@pytest.mark.parametrize("motion", ["levels", "stop-and-go"])
@pytest.mark.parametrize("part", [0.0, 0.03])
def test_quadratic_friction_is_reported_or_within_the_bars(motion: str, part: float) -> None:
    found = fleet.estimate(
        make_log(motion, 2, part * VISCOUS / SPEED),
        axis={
            "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
            "encoder": {"resolution": RESOLUTION},
            "model": {"input_gain": RESOLUTION / DT**2},
        },
        by="axis",
        period="run",
    )
    row = found.axes.row(0, named=True)
    estimate, std = (np.array([row[name + end] for name in found.names]) for end in ("", "_std"))
    apart = np.abs(estimate / (TRUE * [1, 1 / DT, RESOLUTION / DT**2]) - 1)
    assert ("unmodelled" in row["findings"]) <= (part > 0)
    assert np.max(apart) > 0.003 or not part
    assert "unmodelled" in row["findings"] or np.all(apart < 4 * std / estimate)


@pytest.mark.parametrize(("size", "std"), [(0.0, 0.1), (0.4, 0.1), (-0.5, 0.4), (0.1, 3.0)])
def test_the_model_error_is_the_mean_square_of_a_force_with_even_odds(size: float, std: float) -> None:
    def density(x: float) -> float:
        return float(norm.pdf(size, x, std) * norm.pdf(x))

    error = model_error(np.array([[[size, std, 2.0, -3.0]]]), 2)
    exists, absent = quad(density, -8, 8, points=[size])[0], norm.pdf(size, 0, std)
    square = quad(lambda x: x * x * density(x), -8, 8, points=[size])[0] / (exists + absent)
    np.testing.assert_allclose(error.std, np.sqrt(square) * np.array([2.0, 3.0]), rtol=1e-6)
    assert np.all(error.likely == (error.std if exists > absent else 0.0))
