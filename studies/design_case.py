"""The case of the design study: a cart moves 0.4 m in 2 s from rest to rest (paper, section IV-A)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pmfid.design.appraisal import appraise, worth_of
from pmfid.design.problem import Limits, Problem
from pmfid.design.solver import setting, solve
from pmfid.models.drive import Drive

NOMINAL = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
UNKNOWN = {"m": ("mass",), "m, d": ("mass", "viscous_friction"), "m, d, F_c": tuple(NOMINAL)}
LIMITS = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
MIN_SPEED = LIMITS.min_speed
RESOLUTION = 22.75e-6
STARTS = 50
KNOWN = 0.005


def case(
    unknown: str,
    *,
    min_speed: float = MIN_SPEED,
    resolution: float = RESOLUTION,
    samples_per_interval: int = 1,
) -> Problem:
    """Return the case for a key of UNKNOWN; min_speed [m/s], resolution [m per count]."""
    return Problem(
        Drive(2.0),
        NOMINAL,
        UNKNOWN[unknown],
        horizon=2.0,
        intervals=40,
        limits=Limits(input=3.0, position=(0.0, 0.4), min_speed=min_speed),
        resolution=resolution,
        end=(0.4, 0.0),
        samples_per_interval=samples_per_interval,
    )


def known(problem: Problem) -> Problem:
    """Return the problem for a machine known to a fraction KNOWN, so that no possible machine comes to rest."""
    return replace(problem, prior=np.diag([(KNOWN * problem.nominal[name]) ** -2.0 for name in problem.names]))


def gains() -> Iterator[list[str]]:
    """Yield rows: unknown, criterion, value, gain over the standard inputs of GAINS, fraction left with stiction."""
    for unknown in UNKNOWN:
        for criterion in ("trace", "D", "A") if len(UNKNOWN[unknown]) > 1 else ("trace",):
            problem = case(unknown)
            design = solve(problem, criterion, starts=STARTS)
            found = appraise(design)
            cells = [f"{found.gain[name]:.2f}" for name in GAINS]
            yield [unknown, criterion, f"{design.value:.4g}", *cells, f"{found.worths['design'].surviving:.4f}"]


GAINS = ("trapezoid", "s_curve", "minimum_energy", "minimum_time", "pulses", "prbs", "multisine", "chirp")


def trap() -> Iterator[list[str]]:
    """Yield rows: unknown, criterion, value over that of a design with a least speed, fraction left with stiction."""
    for unknown, criterion in (("m", "trace"), ("m, d", "D"), ("m, d, F_c", "D"), ("m, d, F_c", "A")):
        careful = solve(case(unknown), criterion, starts=STARTS)
        problem = case(unknown, min_speed=0.0)
        found = appraise(solve(problem, criterion, starts=STARTS))
        worth = found.worths["design"]
        yield [unknown, criterion, f"{worth.value / careful.value:.3f}", f"{worth.surviving:.3f}"]


def pattern() -> Iterator[list[str]]:
    """Yield rows: least speed, counts per sample at it, value, deviations of m, d, F_c with the encoder over
    predicted.
    """
    for min_speed in (0.0095, 0.01, 0.0102, 0.0103, 0.0105, 0.011):
        problem = known(case("m, d, F_c", min_speed=min_speed))
        worth = worth_of(setting(problem, "D"), solve(problem, "D", starts=STARTS).u)
        ratios = [f"{worth.std_encoder[name] / std:.2f}" for name, std in worth.predicted_std.items()]
        counts = min_speed * problem.dt / RESOLUTION
        yield [f"{1e3 * min_speed:g} mm/s", f"{counts:.2f}", f"{worth.value:.4g}", ", ".join(ratios)]
