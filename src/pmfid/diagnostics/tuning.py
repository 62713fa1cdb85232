"""Thresholds, limits and counts of `pmfid.diagnostics`, each with the decision that depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class DiagnosticTuning:
    """Thresholds and counts of `pmfid.diagnostics`, grouped by module."""

    # balance
    #: Encoder noise of the velocity, relative to the standard deviation of the velocity, that moves hardly any sample
    #: to another bin.
    quiet_encoder: float = 0.003
    #: Smallest part of the filter's memory with one direction of motion for which friction belongs to a single
    #: velocity.
    one_way: float = 0.95
    most_bins: int = 24
    fewest_bins: int = 6
    #: Longest lag of the correlations in a report, in time constants of the filter.
    shown_lags: float = 10.0
    #: Number of standard deviations above which a difference is real. The number is high because many bins and lags are
    #: tested.
    significant: float = 4.5
    #: Residual force, relative to the model's friction, that is too small for a warning even if the force is real.
    relevant_force: float = 0.03
    #: Correlated part of the residual, relative to the input force, that is too small for a warning.
    relevant_part: float = 0.005
    #: Fit of the velocity [%] below which the model does not follow the motion.
    good_fit: float = 90.0
    #: Multiple of the encoder's error above which a velocity error belongs to the model.
    above_encoder: float = 3.0
    #: Correlation above which the residual depends on its past at lags that the filter does not explain.
    balance_correlated: float = 0.2
    #: Number of filter time constants after which the filter alone leaves no correlation.
    filter_lags: float = 5.0

    # causality
    #: Smallest number of lags of the input. The next constants are the largest number of lags, the samples for each
    #: further lag, and the number of future lags.
    causality_least: int = 8
    causality_most: int = 40
    samples_per_lag: int = 15
    causality_ahead: int = 10
    #: Prediction of the input from its past. `own_past` and `short_past` are the numbers of past samples in the final
    #: and the first prediction. `causality_trials` is the number of subsets for the first prediction, and
    #: `robust_passes` is the number of passes. Each prediction holds for `causality_block` samples. `causality_jump` is
    #: the size of a jump in robust standard deviations.
    own_past: int = 20
    short_past: int = 5
    causality_trials: int = 60
    robust_passes: int = 4
    causality_block: int = 500
    causality_jump: float = 4.5
    #: Number of alternations between the noise fit and the regression.
    causality_passes: int = 3
    #: Relative size of a remainder below which the other columns explain a column up to rounding.
    causality_apart: float = 1e-7

    # drives
    #: Factor by which a jump of the counts exceeds the usual changes. No motion explains a change beyond this factor.
    drives_jump: int = 30
    #: Smallest delay [samples] in a report if no score supports the delay. A smaller delay resembles other effects,
    #: such as friction within a sample.
    drives_least: float = 0.05
    #: Counts per sample below which the encoder's error is not white noise.
    drives_coarse: float = 1.0
    #: Smallest number of samples for a judgement of a model. A judgement also needs at least one moving sample.
    drives_fewest: int = 50
    #: Length of the judged part at the end of the record, in memories of an estimator with forgetting.
    drives_memories: float = 3.0
    #: Relative error of a method above which a finding is due.
    drives_biased: float = 0.01

    # free_run
    #: Lengths of the free runs [s]. `free_run_worth` is the smallest ratio of a run to the stretch that determines its
    #: start. Shorter or longer records use the same lengths, scaled by powers of ten.
    free_run_horizons: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)
    free_run_worth: float = 4.0
    #: Largest number of runs for each horizon.
    most_runs: int = 200
    #: Greatest number whose square is still a finite float.
    beyond: float = 1e120
    #: Smallest number of samples for each unknown in the fit of a start.
    free_run_samples: int = 4

    # matter
    #: Relative error of a parameter that does not matter.
    matter_tolerance: float = 0.01
    #: Half-width of the 95 % interval of a normal variable in standard deviations. `noise_limit` is the number of
    #: standard errors within which an error is noise.
    normal_95: float = 1.96
    noise_limit: float = 3.0

    # processes
    #: Greatest probability that a record with the right hold suggests the other hold.
    hold_chance: float = 1e-4
    #: Number of standard errors above which two values of a parameter are far apart.
    processes_far: float = 2.0
    #: Relative decrease of the sum of squares below which a step is unnecessary and a model is judged.
    processes_settled: float = 1e-6
    #: Greatest probability that a record of noise alone passes the test.
    noise_chance: float = 1e-2
    #: Probability of chance below which the colour of the noise has moved the estimate.
    processes_elsewhere: float = 1e-3
    #: Greatest part of the right models in open loop that a test of unmodelled effects or of feedback rejects.
    false_alarm: float = 1e-4
    #: Greatest residual that a wrong hold causes. Its unit is the difference between the responses with both holds at
    #: their first sample.
    wrong_hold: float = 2.0
    #: Relative standard deviation above which a pole is unknown. The relative standard deviation of a real pole is at
    #: most half of the limit, because bars of two standard deviations do not cross zero.
    processes_unknown: float = 0.4
    #: Explained part of the output [%] below which a finding is due.
    poor_fit: float = 10.0
    #: Size of an outlier in robust standard deviations. `processes_few` is the greatest part of the samples that may be
    #: outliers.
    far_outlier: float = 10.0
    processes_few: float = 0.01

    # term_fits
    #: Largest number of parts of a sample in the simulations of a search. For a cart under a random binary input, the
    #: log-likelihoods with 2 and with 16 parts differ by at most 0.1. The log-likelihoods with 1 and with 16 parts
    #: differ by up to 4.
    most_parts: int = 2
    #: Relative tolerance of intermediate least-squares fits.
    term_fits_roughly: float = 1e-4
    #: Noise [counts] below which a fit above the noise floor may be at a local maximum of the likelihood.
    term_fits_suspicious: float = 0.25
    #: Gain of the log-likelihood below which a step is the last one.
    term_fits_settled: float = 0.1
    #: Relative tolerance of fits that only compare pitches. `term_fits_loose` is the noise [counts] at which the edges
    #: of the counts distinguish pitches.
    term_fits_coarsely: float = 1e-3
    term_fits_loose: float = 0.1
    #: Largest number of pitches that the search follows, because the likelihood distinguishes pitches with similar
    #: motions.
    most_pitches: int = 2
    #: Start values of a lag [samples].
    term_fits_lags: tuple[float, float] = (0.5, 2.0)
    #: Part of a sample by which rounding may change the length of a record part.
    term_fits_rounding: float = 1e-6
    #: Number of windows in each part of a record that is predicted from the other parts.
    term_fits_windows: int = 4

    # term_trials
    #: Relative step of the parameters for a numerical derivative.
    term_trials_small: float = 1e-4
    #: Smallest and greatest number of pitches in the travel. A force with fewer pitches resembles other forces. The
    #: search ignores forces with more pitches.
    term_trials_fewest: float = 4.0
    term_trials_most: float = 150.0
    #: Smallest length of a pitch, in counts and in samples at the usual speed.
    term_trials_counts: float = 8.0
    term_trials_samples: float = 4.0
    #: Distance between the tried numbers of pitches. `at_a_time` is the number of pitches that are tried together.
    term_trials_apart: float = 0.5
    at_a_time: int = 40
    #: Number of peaks that each scan follows. `term_trials_between` is the smallest distance of two peaks, in pitches
    #: of the travel.
    term_trials_peaks: int = 2
    term_trials_between: float = 0.9
    #: Cutoffs of the balance relative to the cutoff of the filters. With fast filters the encoder's error hides a slow
    #: force. With slow filters friction hides a fast force.
    term_trials_slower: tuple[float, float] = (1.0, 1 / 3)
    #: Factor between the number of pitches and its scaled value in a fit. A step of the fit then changes the number by
    #: a hundredth of a pitch.
    term_trials_hundred: float = 100.0

    # terms
    #: Smallest score that deserves a trial if the model does not explain every count, because unmodelled effects then
    #: scatter the scores.
    terms_weak: float = 1.0
    #: Largest number of terms that a step fits if no term explains every count, and largest number of steps.
    most_tried: int = 4
    most_steps: int = 8
    #: Largest number of pitches that the search tries together with another term if no single term suffices.
    most_paired: int = 2
    #: Approximate number of candidates in each step, without periodic forces and pitches.
    terms_usual: int = 8
    #: Gain that each further parameter of a term has to bring.
    per_parameter: float = 4.0
    #: Difference between the gains of two terms below which the terms explain equally much. The difference corresponds
    #: to three standard deviations.
    terms_alike: float = 9.0
    #: Relative gain of the second-best pitch above which the pitch remains ambiguous.
    terms_hardly: float = 0.5
    #: Relative increase of the error of free runs above which a model is worse. The last steps of a fit cause smaller
    #: differences.
    no_worse: float = 0.002

    # verdict
    #: Prior odds that a machine has a plausible force. Every machine has some of the tested forces.
    verdict_odds: float = 10.0
    #: Greatest argument of the exponential function, because larger results are useless.
    most_evidence: float = 500.0


TUNING = DiagnosticTuning()
