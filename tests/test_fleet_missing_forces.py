"""The error bars of a history contain the errors by forces that its model lacks, and stay small for a right model."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from pmfid import fleet
from pmfid.config.keys import AxisKeys
from pmfid.fleet.missing_forces import model_error
from studies.referee.motions import MOTIONS, Pace, Rng
from tests.oracles.axis import Axes, Excitation, simulate_axes

#: Mass, viscous and Coulomb friction of the axes, in counts, samples and parts of the largest input.
TRUE = np.array([0.12, 0.0024, 0.15])
AXES, SAMPLES, DT, RESOLUTION = 3, 6000, 0.02, 1e-5
NAMES = ("mass", "viscous_friction", "coulomb_friction")


def make_log(motion: str, seed: int, **effects: float) -> pl.DataFrame:
    """Return the rows of some axes that move by a motion of the referee. `effects` has forces beyond the model."""
    mass, viscous, coulomb = TRUE
    pace = Pace(mass, viscous, coulomb, mass / viscous, 40, (1 - coulomb) / viscous)
    rngs: list[Rng] = [np.random.default_rng([seed, k]) for k in range(AXES)]
    commands = [MOTIONS[motion](SAMPLES, pace, rng) for rng in rngs]
    ones, shape = np.ones(AXES), (SAMPLES, AXES)
    excitation = Excitation(
        feed=np.stack([one.feed for one in commands], axis=1),
        step=np.ones(shape),
        reference=np.stack([one.reference for one in commands], axis=1),
        kp=np.array([one.kp for one in commands]),
        kd=np.array([one.kd for one in commands]),
        window=np.array([one.window for one in commands]),
        top=ones,
        push=np.zeros(shape),
        friction=np.ones(shape),
    )
    axes = Axes(mass * ones, viscous * ones, coulomb * ones, **{name: size * ones for name, size in effects.items()})
    motions = simulate_axes(axes, excitation, np.array([rng.random() for rng in rngs]), substeps=2)
    time = np.arange(SAMPLES) * DT
    return pl.concat(
        pl.DataFrame({"axis": [f"a{k}"] * SAMPLES, "t": time, "u": motions.u[:, k], "counts": motions.counts[:, k]})
        for k in range(AXES)
    )


def errors(log: pl.DataFrame) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the relative errors (axes, p), the errors in error bars, and the findings."""
    config: AxisKeys = {
        "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
        "encoder": {"resolution": RESOLUTION},
        "model": {"input_gain": RESOLUTION / DT**2},
    }
    found = fleet.estimate(log, axis=config, by="axis", period="run", workers=1).axes.sort("axis")
    truth = TRUE * [1, 1 / DT, RESOLUTION / DT**2]
    apart = found.select(NAMES).to_numpy() - truth
    std = found.select(f"{name}_std" for name in NAMES).to_numpy()
    return apart / truth, apart / std, found["findings"].to_list()


@pytest.mark.parametrize("motion", ["levels", "stop-and-go"])
def test_a_right_model_has_small_bars_and_no_finding(motion: str) -> None:
    relative, bars, findings = errors(make_log(motion, 1))
    assert not any("unmodelled" in text for text in findings)
    assert np.sqrt(np.mean(bars**2)) < 1.7
    assert np.all(np.abs(relative / bars) < 0.03)


@pytest.mark.parametrize("motion", ["levels", "stop-and-go"])
def test_quadratic_friction_is_reported_or_within_the_bars(motion: str) -> None:
    speed = (1 - TRUE[2]) / TRUE[1]
    relative, bars, findings = errors(make_log(motion, 2, quadratic=0.03 * TRUE[1] / speed))
    assert np.max(np.abs(relative)) > 0.003
    silent = np.array(["unmodelled" not in text for text in findings])
    assert np.all(np.abs(bars[silent]) < 4)


@pytest.mark.parametrize(("size", "std"), [(0.0, 0.1), (0.2, 0.1), (0.4, 0.1), (-0.5, 0.4), (0.1, 3.0)])
def test_the_model_error_is_the_mean_square_of_a_force_with_even_odds(size: float, std: float) -> None:
    looks = np.array([[[size, std, 2.0, -3.0]]])

    def density(x: float) -> float:
        return float(norm.pdf(size, x, std) * norm.pdf(x))

    exists, _ = quad(density, -8, 8, points=[size])
    square, _ = quad(lambda x: x * x * density(x), -8, 8, points=[size])
    wanted = np.sqrt(square / (exists + norm.pdf(size, 0, std)))
    np.testing.assert_allclose(model_error(looks, 2).std, wanted * np.array([2.0, 3.0]), rtol=1e-6)
    likely = exists > norm.pdf(size, 0, std)
    assert np.all(model_error(looks, 2).likely == (model_error(looks, 2).std if likely else 0.0))
