"""Thresholds, limits and counts of `pmfid.design`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class DesignTuning:
    """One value for each decision of `pmfid.design`, by module."""

    # appraisal
    #: The expected deviations are themselves known to a few percent.
    appraisal_surely: float = 0.95
    #: Least speeds over the one of the limits: the first two leave whole counts per sample, the others keep a machine
    #: moving that is heavier, or has more friction, than its data sheet says.
    appraisal_faster: tuple[float, ...] = (1.23, 1.57, 2.5, 4.0, 6.0)
    #: Least part of the claimed information; a smaller part gives a warning.
    appraisal_survives: float = 0.95

    # ascent
    #: Shifts of the motion, in fortieths of the horizon.
    ascent_shifts: tuple[int, ...] = (1, -1, 4, -4, 16, -16)
    #: Relative gain below which a step, or another local optimum, counts for nothing.
    ascent_tolerance: float = 1e-4
    ascent_same: float = 1e-5
    #: How far ahead of a full step the next gradient may be taken, in steps.
    ascent_furthest: float = 8.0
    #: Relative gain of a full step that is only a drift.
    ascent_drift: float = 0.05
    #: How sharply the worst of several cases counts.
    ascent_sharpness: float = 100.0
    #: Greatest excess of a motion over its share.
    ascent_enough: float = 1e-6
    ascent_rounds: int = 2000
    #: Weights below this take no part.
    ascent_negligible: float = 1e-6
    #: New motions at most, and starts of the search for each.
    ascent_motions: int = 30
    ascent_searches: int = 4

    # bounds
    #: Added to every range: the linear solver works to 1e-7.
    bounds_slack: float = 1e-7
    #: Share of the chords' gap that is worth narrowing; another round must take away a part of the excess. More rounds
    #: are lost on a part that has to be halved all the same.
    bounds_worth: float = 0.9
    bounds_progress: float = 0.15
    bounds_rounds: int = 2
    #: Vertices that a node remembers, for mixtures.
    bounds_remembered: int = 80
    least_gain: float = 0.02
    #: What the tolerances of the linear solver may add to a bound, in units of the incumbent's value.
    slack_of_bound: float = 1e-6

    # calibration
    max_evaluations: int = 200
    #: Ratio of root mean squares, residual over motion, from which the fit is refused.
    worst_fit: float = 0.2
    #: Deviations that hold 95 % of a normal distribution.
    calibration_normal: float = 1.96

    # encoder_error
    #: Largest stretch (Goodman and Weare 2010).
    encoder_error_longest: float = 2.0
    #: How often a start outside may be moved half the way to the middle.
    encoder_error_halvings: int = 60
    #: Steps towards the middle, and the part of it by which the last one still narrows the range.
    encoder_error_steps: int = 20
    encoder_error_settled: float = 1e-4
    #: Largest distance from the middle along an axis [standard deviations] at which a continuing ridge is searched.
    encoder_error_beyond: float = 4.0
    #: Each step along a ridge is longer than the last by this factor, or half as long if the last one left the ridge;
    encoder_error_longer: float = 1.5
    most_steps: int = 60
    #: longest way back to the middle of the ridge [standard deviations];
    encoder_error_back: float = 30.0
    #: steps shorter than this part of the first end it.
    encoder_error_shortest: float = 1 / 8
    #: Number of machines drawn around the nominal one, the standard deviation of their parameters as a part of the
    #: nominal values, and the deviation that bounds the parameters of a machine at rest.
    encoder_error_machines: int = 32
    encoder_error_wrong: float = 0.06
    encoder_error_far: float = 1.0
    #: Deviations by which a parameter is wrong at most; machines with all of them that wrong are looked at as well.
    encoder_error_furthest: float = 2.0
    #: Condition of an information from which on it leaves a parameter open.
    encoder_error_worst: float = 1e12
    #: Walkers for each of these, steps until they have spread, and steps that count.
    encoder_error_walkers: int = 12
    encoder_error_spread: int = 80
    walker_steps: int = 120
    #: Half a count, and how often what is missing to explain all counts is added to it.
    encoder_error_half: float = 0.5
    encoder_error_missing: float = 2.0
    #: Room that the right model leaves at least, in counts times samples: less in one run of a hundred.
    least_room: float = 0.25
    count_walkers: int = 48
    #: One in encoder_error_checked walkers is checked.
    encoder_error_checked: int = 4
    #: Largest error of the map [counts].
    encoder_error_lost: float = 0.05
    #: Rounds of the walk, each on a map around the last one's middle: steps to spread, steps that count.
    encoder_error_rounds: tuple[tuple[int, int], tuple[int, int], tuple[int, int]] = ((100, 60), (60, 60), (60, 240))
    #: Quantiles of the interval that holds 95 %.
    encoder_error_within: tuple[float, float] = (0.025, 0.975)

    # fisher
    #: Information below is none.
    fisher_tiny: float = 1e-200

    # oracle
    #: A point that misses the energy limit by less is taken to meet it.
    energy_tolerance: float = 1e-9
    #: Tangents that one answer may add, and that are kept in all.
    max_cuts: int = 5
    oracle_kept: int = 60

    # problem
    #: Sizes of what machines are made of, in SI units.
    problem_least: float = 1e-20
    problem_most: float = 1e20

    # rounds
    #: Counts that the model may miss by before no deviation counts as reached.
    rounds_tolerated: float = 0.5

    # simulated
    #: Change of a parameter as a part of its nominal value: far above rounding, far below what bends the motion.
    simulated_step: float = 1e-4

    # solver
    #: Greatest violation of a limit, relative to the terms that the limit compares.
    solver_precision: float = 1e-7
    #: A smaller change is none.
    solver_least: float = 1e-9
    #: Relative difference of the criterion that counts as having reached the best.
    solver_reached: float = 1e-3

    # standard
    #: Periods of the pulses in the whole motion, intervals for which a value of the PRBS is held.
    standard_pulses: int = 4
    standard_clock: int = 3
    #: The highest frequency of multisine and chirp, as a part of the rate of the intervals.
    standard_highest: float = 0.2
    #: Violation of a limit, relative, that rounding explains.
    standard_rounding: float = 1e-7
    #: Parts of what can be reached that legs with a free end try to cover.
    standard_shares: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2)
    #: Largest peak velocity [m/s] in the search for a profile.
    standard_fastest: float = 1e6


TUNING = DesignTuning()
