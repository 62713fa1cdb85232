"""Thresholds, limits and counts of `pmfid.linear`, each with the decision that depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class LinearTuning:
    """Thresholds and counts of `pmfid.linear`, grouped by module."""

    # counts
    #: Rounds of the linearisation of a response, and the relative change of mean and standard deviations that the
    #: random walk may cause.
    counts_rounds: int = 6
    counts_settled: float = 0.4
    #: Chance of rounding alone to leave so small a region, below which noise is the cause.
    counts_chance: float = 0.005

    # experiment
    #: Number of terms of the exponential series for an argument below series_norm. Further terms are below the accuracy
    #: of float64.
    series_terms: int = 14
    series_norm: float = 0.25
    #: Relative deviation from an even spacing below which instants are evenly spaced. Clocks and rounded decimals cause
    #: small deviations from an even spacing.
    experiment_even: float = 5e-3
    #: Distance, relative to the median step, below which two instants are equal, or a dead time ends at an instant.
    experiment_same: float = 1e-9
    #: Longest step without a gap, in median steps. The input within a gap is unknown.
    experiment_gap: float = 1.75
    #: Largest number of samples in the response from reference to input. The next constant is the number of samples of
    #: the record for each sample of the response.
    experiment_response: int = 200
    samples_per_coefficient: int = 10

    # order
    #: Relative decrease of the sum of squares below which a step is unnecessary and a model is judged.
    order_settled: float = 1e-6
    order_passes: int = 10
    #: Poles of the smaller of two models that determine the colour of the noise. The other model has the most poles of
    #: the search.
    order_middle: int = 3
    #: Number of best structures that get more passes if they did not converge.
    order_retried: int = 8
    #: Relative error of the output below which two models are equally good.
    order_exact: float = 1e-7

    # process
    #: Number of standard deviations of the coefficients that determine the spread of a root.
    process_interval: float = 2.0

    # residuals
    #: Largest order in the search for a noise model. `residuals_part` is the smallest number of samples for each order.
    residuals_most: int = 40
    residuals_part: int = 8
    #: Number of passes that restore the part of the noise that the fit removed. `residuals_largest` is the largest
    #: ratio of the restored power to the power of the residual.
    residuals_passes: int = 3
    residuals_largest: float = 3.0
    #: Greatest part of the samples without a successor. `residuals_soon` is the number of lags in a test whether the
    #: noise is white.
    residuals_gaps: float = 0.02
    residuals_soon: int = 11
    #: Number of frequencies in the mean of a spectrum.
    residuals_effective: int = 4096
    #: Smallest number of steps between the end of a line and its beginning in a circular transform.
    residuals_round: int = 256
    residuals_lags: int = 25
    #: Normal deviate of the bounds that contain 99 % of the correlations of an independent residual.
    residuals_deviate: float = 2.576
    #: Relative difference of the inputs, in parts of their range, below which two periods are equal.
    residuals_same: float = 1e-6
    #: Number of samples near the first change of the input that must repeat before all samples are compared.
    residuals_look: int = 4
    #: Smallest number of samples of a period in excess of the parameters. With fewer samples, the residual says
    #: nothing.
    residuals_least: int = 8
    #: Smallest number of lines on either side of a harmonic for comparison, including other harmonics.
    residuals_around: int = 6
    #: Relative size below which the effect of a parameter is a combination of others.
    residuals_rcond: float = 1e-7
    #: Probability of chance below which a residual is periodic, and thus the part of the right models that the test
    #: rejects.
    residuals_chance: float = 1e-4
    #: Smallest part of the samples with a whole past for the whitening filter. If fewer samples have a whole past, the
    #: filter is not used.
    residuals_kept: float = 0.6
    #: Number of steps between the stretches on the line of all samples. The memory of usual noise is shorter.
    residuals_apart: int = 100
    #: Smallest number of degrees of freedom. The effective number of samples limits the accuracy of the noise power,
    #: and Student's t has a larger variance than a normal deviate.
    least_free: float = 4.0

    # solve
    solve_refinements: int = 30
    solve_descents: int = 60
    #: Relative decrease of the sum of squares below which an iteration has converged, to 1e-4 standard deviations or
    #: less.
    solve_settled: float = 1e-12
    #: Decrease of the sum of squares, relative to that of the output, below which only rounding remains.
    solve_rounding: float = 1e-20
    #: Exponent of a pole's growth within the record at which the pole is at the bound of `stable`.
    solve_edge: float = 0.9
    #: Number of unknown poles above which the first optimum may be local.
    solve_several: int = 3
    #: Poles of further start filters relative to the first filter, used if the first filter does not lead to
    #: convergence.
    solve_starts: tuple[float, ...] = (1.0, 3.0, 1 / 3, 10.0)
    #: Number of passes for each whole number of samples. `solve_followed` is the number of best start values for
    #: complete iterations.
    solve_passes: int = 2
    solve_followed: int = 2
    #: Largest distance of the dead time above the largest start value [samples].
    solve_beyond: float = 2.0


TUNING = LinearTuning()
