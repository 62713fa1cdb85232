"""Texts of SPEC.toml for `pmfid design` and `commission`, drawn from valid and broken parts."""

from __future__ import annotations

import numpy as np

from tests.hostile.configurations import some, text_of
from tests.hostile.plants import Columns

Rng = np.random.Generator

NAMES = ["mass", "viscous_friction", "coulomb_friction"]
#: A design that succeeds takes a second, so that most specifications must be refused.
BROKEN = 0.02


def spec(rng: Rng, resolution: float) -> str:
    """Return the text of a SPEC.toml for a cart with few intervals; `resolution` is the encoder's [m]."""
    intervals = int(rng.integers(1, 7))
    sections = {
        "drive": _drive(rng),
        "encoder": {"resolution": resolution, **some(rng, 0.1, noise_std=[1e-5], samples_per_interval=[1, 4])},
        "experiment": _experiment(rng),
        "motion": _motion(rng, intervals),
        "limits": _limits(rng),
        "search": {"starts": int(rng.integers(1, 3)), "seed": int(rng.integers(5))},
        **some(rng, 0.15, prior=[{"mass": 0.1}, {"offset": 1.0}], robust=[{"mass": 0.2}, {"viscous_friction": 0.1}]),
        **some(rng, 0.1, record=[{"input": "u", "output": "counts", "output_kind": "counts", "time": "t"}]),
    }
    return text_of(rng, sections, BROKEN)


def _drive(rng: Rng) -> Columns:
    values = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    factors = rng.choice([1.0, 1e-6, 1e6, 0.0], 3, p=[0.9, 0.04, 0.04, 0.02]).tolist()
    scaled = {name: value * factor for (name, value), factor in zip(values.items(), factors, strict=True)}
    return {"input_gain": 2.0, **scaled, **some(rng, 0.1, offset=[0.0, 0.5, -1e3])}


def _experiment(rng: Rng) -> Columns:
    unknown = [name for name in NAMES if rng.random() < 0.75]
    return {
        "unknown": unknown if rng.random() < 0.95 else [*unknown, "colour"],
        "criterion": str(rng.choice(["trace", "D", "A", "E", "ME", "c"])),
        **some(rng, 0.15, scaled=[True, False], weights=[{"mass": 1.0}, {}, {"mass": 0.0}], nuisance=[["mass"], NAMES]),
    }


def _motion(rng: Rng, intervals: int) -> Columns:
    return {
        "duration": float(rng.choice([2.0, 0.5, 1e-3, 1e3], p=[0.85, 0.05, 0.05, 0.05])),
        "intervals": intervals,
        **some(rng, 0.5, end=[0.4, 0.4, -0.4, 0.0, 1e3], end_velocity=[0.0, 0.0, 1.0]),
        **some(rng, 0.1, start=[0.0, 0.2], start_velocity=[0.0, 0.1, -1.0], end_tolerance=[[0.01, 0.0], [1.0, 1.0]]),
        **some(rng, 0.1, directions=[[1] * intervals, [1, -1] * 3, [0] * intervals, [2]]),
    }


def _limits(rng: Rng) -> Columns:
    return {
        **some(rng, 0.9, input=[3.0, 3.0, 10.0, [-1.0, 5.0], [5.0, -1.0], 1e-9]),
        **some(rng, 0.3, position=[[0.0, 0.4], [-1.0, 1.0], [0.4, 0.0]], velocity=[1.0, [0.0, 1.0], 1e-9]),
        **some(rng, 0.1, acceleration=[5.0, 1e-3], jerk=[50.0], input_rate=[30.0, 1e-3]),
        **some(rng, 0.1, energy=[5.0, 1e-9], rms=[2.0], min_speed=[0.01, 0.0, 10.0]),
    }
