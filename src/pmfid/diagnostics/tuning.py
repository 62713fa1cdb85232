"""Thresholds, limits and counts of `pmfid.diagnostics`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class DiagnosticTuning:
    """One value for each decision of `pmfid.diagnostics`, by module."""

    # balance
    #: Encoder noise of the velocity, as a part of its standard deviation, that moves no sample to another bin to speak
    #: of.
    quiet_encoder: float = 0.003
    #: Part of the filter's memory with one direction of motion, from which on friction is that of one velocity.
    one_way: float = 0.95
    most_bins: int = 24
    fewest_bins: int = 6
    #: Filter time constants over which correlations are shown.
    shown_lags: float = 10.0
    #: Standard deviations from which on a difference is taken for real: there are many bins and lags to choose from.
    significant: float = 4.5
    #: A force that is real but a smaller part of the model's friction is not worth a warning.
    relevant_force: float = 0.03
    #: The same for a correlated part of the residual, as a part of the input force.
    relevant_part: float = 0.005
    #: Fit of the velocity [%] below which the model does not follow.
    good_fit: float = 90.0
    #: A velocity error is the model's from this multiple of the encoder's own error on.
    above_encoder: float = 3.0
    #: Correlation at lags that the filter no longer explains.
    balance_correlated: float = 0.2
    #: Filter time constants after which the filter alone leaves no correlation.
    filter_lags: float = 5.0

    # causality
    #: Lags of the input: least and greatest number, samples for each further lag; number of future lags.
    causality_least: int = 8
    causality_most: int = 40
    samples_per_lag: int = 15
    causality_ahead: int = 10
    #: Own past from which the input is predicted, in the end and at first; choices of samples for the first prediction;
    #: passes; samples that a prediction holds for; what is a jump, in robust standard deviations.
    own_past: int = 20
    short_past: int = 5
    causality_trials: int = 60
    robust_passes: int = 4
    causality_block: int = 500
    causality_jump: float = 4.5
    #: Passes of noise and regression.
    causality_passes: int = 3
    #: Less of a column than this is left by the others: none, but rounding.
    causality_apart: float = 1e-7

    # drives
    #: A change of the counts that exceeds the usual ones by this factor is no motion.
    drives_jump: int = 30
    #: Least delay [samples] that is reported without a score that names it: a smaller one imitates other effects, as
    #: friction within a sample.
    drives_least: float = 0.05
    #: Counts per sample below which the encoder's error is no white noise.
    drives_coarse: float = 1.0
    #: With fewer samples, or none that moves, there is nothing to judge a model by.
    drives_fewest: int = 50
    #: With forgetting, the last part of the record is judged: its length in memories.
    drives_memories: float = 3.0
    #: A method's own error, relative, that is worth a word of its own.
    drives_biased: float = 0.01

    # free_run
    #: Seconds after which a run is begun again, and how many times longer than the reading of its start they must be;
    #: of what is slower or faster the same numbers of tenths, tens or hundreds of seconds.
    free_run_horizons: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)
    free_run_worth: float = 4.0
    #: Runs of one horizon that are looked at.
    most_runs: int = 200
    #: The square of a number must not leave the format.
    beyond: float = 1e120
    #: Samples that the start of a stretch is read from, for each of its unknowns, at least.
    free_run_samples: int = 4

    # matter
    #: Relative error of a parameter that is of no matter.
    matter_tolerance: float = 0.01
    #: Standard deviations within which 95 % of a normal variable are, to either side; standard errors within which an
    #: error is noise.
    normal_95: float = 1.96
    noise_limit: float = 3.0

    # processes
    #: The other hold is better where so few records with the right one would say so, at the worst.
    hold_chance: float = 1e-4
    #: Two values of a parameter are far apart from this number of standard errors on.
    processes_far: float = 2.0
    #: A model is judged once a step would lower its sum of squares by less than this part.
    processes_settled: float = 1e-6
    #: A record of noise alone passes but so often.
    noise_chance: float = 1e-2
    #: An estimate is moved that far by the colour of the noise in so small a part of the cases.
    processes_elsewhere: float = 1e-3
    #: Part of the right models in open loop that a test of unmodelled effects or of feedback may reject.
    false_alarm: float = 1e-4
    #: A wrong hold puts at most this multiple of the difference of the two responses at their first sample into the
    #: residual.
    wrong_hold: float = 2.0
    #: A pole with a standard deviation of more than this part of its size is not known. A real one has at most half of
    #: it: bars are measured over two standard deviations, and it does not move beyond 0.
    processes_unknown: float = 0.4
    #: Less of the output explained [%] is worth a sentence.
    poor_fit: float = 10.0
    #: An output further off than FAR robust standard deviations, in less than a part FEW of the samples, is an outlier.
    far_outlier: float = 10.0
    processes_few: float = 0.01

    # term_fits
    #: Parts of a sample in which the motions of a search are simulated at most: with 2 the likelihoods of a cart under
    #: a random binary input are within 0.1 of those with 16, and with 1 within 4.
    most_parts: int = 2
    #: Relative tolerance of least squares on the way.
    term_fits_roughly: float = 1e-4
    #: Noise [counts] above the floor, but below this value, may belong to a local maximum of the likelihood.
    term_fits_suspicious: float = 0.25
    #: A step up the likelihood that gains less is the last one.
    term_fits_settled: float = 0.1
    #: The same where a pitch is only to be compared with others, and noise [counts] at which the edges tell them apart.
    term_fits_coarsely: float = 1e-3
    term_fits_loose: float = 0.1
    #: Pitches that are gone on from: those whose motions are alike the likelihood tells apart.
    most_pitches: int = 2
    #: Lags to start from [samples].
    term_fits_lags: tuple[float, float] = (0.5, 2.0)
    #: Part of a sample that a cutoff may be rounded by.
    term_fits_rounding: float = 1e-6
    #: Windows of each part that the others predict it with.
    term_fits_windows: int = 4

    # term_trials
    #: A step of parameters for a derivative.
    term_trials_small: float = 1e-4
    #: Least and greatest number of pitches in the travel: fewer resemble other forces, more are not looked for.
    term_trials_fewest: float = 4.0
    term_trials_most: float = 150.0
    #: Counts, and samples at the usual speed, that a pitch has at least.
    term_trials_counts: float = 8.0
    term_trials_samples: float = 4.0
    #: Distance of the numbers of pitches that are tried, and how many are tried at a time.
    term_trials_apart: float = 0.5
    at_a_time: int = 40
    #: Peaks that are gone on from in each scan, and pitches of the travel between two of them.
    term_trials_peaks: int = 2
    term_trials_between: float = 0.9
    #: Cutoffs of the balance, as parts of the filters' cutoff: with fast filters the encoder's error hides a slow
    #: force, with slow filters friction hides a fast one.
    term_trials_slower: tuple[float, float] = (1.0, 1 / 3)
    #: Pitches that are looked at on the way are counted in hundreds, so that they are moved by a hundredth of one.
    term_trials_hundred: float = 100.0

    # terms
    #: Least score that is worth a trial if the model does not explain every count: unmodelled effects then scatter the
    #: scores.
    terms_weak: float = 1.0
    #: Terms that are fitted in each step where none explains every count, and steps.
    most_tried: int = 4
    most_steps: int = 8
    #: Pitches that are tried together with another term where no single one suffices.
    most_paired: int = 2
    #: Number of candidates in each step, about, without periodic forces and pitches.
    terms_usual: int = 8
    #: A gain that every further parameter of a term has to bring.
    per_parameter: float = 4.0
    #: Gains of two terms that differ by less, in the units of chance, are the same: three standard deviations.
    terms_alike: float = 9.0
    #: A pitch that explains more than this part of what the best one explains leaves open which it is.
    terms_hardly: float = 0.5
    #: Free runs over other parts are worse from this part on: below is what the last steps of a fit leave.
    no_worse: float = 0.002

    # verdict
    #: Prior odds that a machine has a plausible force: no machine has none of them.
    verdict_odds: float = 10.0
    #: exp of more is beyond use.
    most_evidence: float = 500.0


TUNING = DiagnosticTuning()
