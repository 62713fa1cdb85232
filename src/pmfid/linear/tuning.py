"""Thresholds, limits and counts of `pmfid.linear`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class LinearTuning:
    """One value for each decision of `pmfid.linear`, by module."""

    # experiment
    #: Terms of the exponential series once its argument is scaled below series_norm: beyond float64.
    series_terms: int = 14
    series_norm: float = 0.25
    #: Columns of a product of a small matrix with a long one at a time.
    experiment_block: int = 2048
    #: Instants closer than this to an even spacing, in parts of the step, are evenly spaced: clocks and decimals do
    #: that.
    experiment_even: float = 5e-3
    #: Two instants closer than this, in parts of the median step, are one.
    experiment_same: float = 1e-9
    #: A longer step, in medians, is a gap: what the input did in it is not known.
    experiment_gap: float = 1.75
    #: Samples of the response from reference to input, and how many samples of a record there must be for each of them.
    experiment_response: int = 200
    samples_per_coefficient: int = 10

    # order
    #: A model is judged once a step would lower its sum of squares by less than this part.
    order_settled: float = 1e-6
    order_passes: int = 10
    #: Poles of the smaller one of two models that the colour of the noise is taken from; the other one has the most
    #: poles.
    order_middle: int = 3
    #: Best structures among those that did not settle, which are given more passes.
    order_retried: int = 8
    #: A model counts as follows the record no closer than this part of the output: two such models are equally good.
    order_exact: float = 1e-7

    # process
    #: Standard deviations over which the spread of a root is measured.
    process_interval: float = 2.0

    # residuals
    #: Orders that are tried: up to this, and no more than a part of the samples.
    residuals_most: int = 40
    residuals_part: int = 8
    #: Passes that restore the part of the noise that the fit took, and the largest power, over the power of the
    #: residual.
    residuals_passes: int = 3
    residuals_largest: float = 3.0
    #: Part of the samples whose follower may be missing; lags that tell whether the noise is white.
    residuals_gaps: float = 0.02
    residuals_soon: int = 11
    #: Frequencies over which a spectrum is averaged.
    residuals_effective: int = 4096
    #: Steps between the ends of a line and its beginning, on the circle of a transform, at least.
    residuals_round: int = 256
    residuals_lags: int = 25
    #: Normal deviate of the bounds, which contain 99 % of independent residuals.
    residuals_deviate: float = 2.576
    #: Two periods are the same if no input differs by more than this part of its range.
    residuals_same: float = 1e-6
    #: Samples around the first change of the input that a period must show again, before all are compared.
    residuals_look: int = 4
    #: Least number of samples of a period in excess of the parameters; with fewer, the residual says nothing.
    residuals_least: int = 8
    #: Lines on either side of a harmonic that it is compared with, at least, harmonics among them.
    residuals_around: int = 6
    #: Effects of parameters that are combinations of others up to this part.
    residuals_rcond: float = 1e-7
    #: The residual repeats where so few records without an error of the model would seem to.
    residuals_chance: float = 1e-4
    #: Less than this part of the samples left by the filter, which needs its whole past: it is not used.
    residuals_kept: float = 0.6
    #: Steps between the stretches on the line of all samples: more than what a noise usually remembers.
    residuals_apart: int = 100
    #: Degrees of freedom, at least: the effective number of samples bounds how well the power of the noise is known,
    #: and Student's t has a larger variance than a normal deviate.
    least_free: float = 4.0

    # responses
    #: A dead time that ends so close before an instant, in parts of the step, ends there.
    responses_same: float = 1e-9

    # solve
    solve_refinements: int = 30
    solve_descents: int = 60
    #: A step that would lower the sum of squares by less than this part has settled: 1e-4 standard deviations or less.
    solve_settled: float = 1e-12
    #: ... or by less than this part of the output's sum of squares: what is left is rounding.
    solve_rounding: float = 1e-20
    #: A pole that would grow by more than this power of e within the record is at the bound of `stable`.
    solve_edge: float = 0.9
    #: Unknown poles from which on the first optimum may be a local one.
    solve_several: int = 3
    #: Another optimum is better if its sum of squares is lower by this part.
    solve_lower: float = 1e-9
    #: Further filter poles to start from, in parts of the first, where that does not settle.
    solve_starts: tuple[float, ...] = (1.0, 3.0, 1 / 3, 10.0)
    #: Passes for each whole number of samples, and how many of the best are followed to the end.
    solve_passes: int = 2
    solve_followed: int = 2
    #: Samples beyond the largest of these that the dead time may still reach.
    solve_beyond: float = 2.0


TUNING = LinearTuning()
