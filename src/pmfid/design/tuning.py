"""Thresholds, limits and counts of `pmfid.design`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class DesignTuning:
    """All thresholds of `pmfid.design`, ordered by module."""

    # appraisal
    #: Factor for "better". The expected deviations themselves are known to 10 % at best (`expected_machines`).
    appraisal_surely: float = 0.95
    #: Part of the claimed information that must survive stiction. A smaller part gives a warning.
    appraisal_survives: float = 0.95
    #: Parts of the nominal values for which information must survive. An axis may just stop, or just fail to stop.
    appraisal_near: tuple[float, ...] = (0.9999, 1.0, 1.0001)

    # ascent
    #: Shifts of the motion, in fortieths of the horizon.
    ascent_shifts: tuple[int, ...] = (1, -1, 4, -4, 16, -16)
    #: Relative gain below which a step, or another local optimum, does not count.
    ascent_tolerance: float = 1e-4
    ascent_same: float = 1e-5
    #: Largest distance ahead of a full step at which the next gradient is taken, in steps.
    ascent_furthest: float = 8.0
    #: Relative gain of a full step below which the step is only a drift.
    ascent_drift: float = 0.05
    #: Largest excess of a motion over its share at which the weights count as converged. Smaller weights become 0.
    ascent_enough: float = 1e-6
    ascent_rounds: int = 2000
    #: Largest number of new motions, and the number of starts in the search for each motion.
    ascent_motions: int = 30
    ascent_searches: int = 4

    # bounds
    #: Share of the chords' gap that is worth narrowing. Another round must take away `bounds_progress` of the excess.
    #: More rounds do not help a part that has to be halved in any case.
    bounds_worth: float = 0.9
    bounds_progress: float = 0.15
    bounds_rounds: int = 2
    #: Number of vertices that a node remembers for mixtures.
    bounds_remembered: int = 80
    least_gain: float = 0.02
    #: Error that the tolerances of the linear solver may add to a bound, in units of the incumbent's value.
    slack_of_bound: float = 1e-6

    # expected
    #: Condition number of an information from which a parameter counts as open.
    expected_open: float = 1e12
    #: Least number of machines, whose mean standard deviation is then known to 10 %.
    expected_machines: int = 16
    #: Deviation of the machines' parameters from the data sheet, as a part of the nominal values.
    expected_wrong: float = 0.1

    # oracle
    #: Largest number of tangents that one answer may add, and that are kept in total.
    max_cuts: int = 5
    oracle_kept: int = 60

    # problem
    #: Largest size of a value of a machine, in SI units. Its inverse is the smallest size.
    problem_most: float = 1e20

    # ranking
    #: Parts of the limit of the input that a standard input tries.
    ranking_sizes: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08)

    # solver
    #: Largest violation of a limit, relative to the terms that the limit compares. The linear solver works to it.
    solver_precision: float = 1e-7
    #: Relative difference of the criterion within which a start counts as having reached the best.
    solver_reached: float = 1e-3

    # standard
    #: Number of pulse periods in the whole motion, and number of intervals that hold one value of the PRBS.
    standard_pulses: int = 4
    standard_clock: int = 3
    #: Highest frequency of multisine and chirp, as a fraction of the interval rate.
    standard_highest: float = 0.2
    #: Numbers of intervals that hold one value, and highest frequencies as parts of the interval rate, for a ranking.
    standard_holds: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    standard_highests: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    #: Parts of the reachable distance that legs with a free end try to cover.
    standard_shares: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2)
    #: Largest peak velocity [m/s] in the search for a profile.
    standard_fastest: float = 1e6


TUNING = DesignTuning()
