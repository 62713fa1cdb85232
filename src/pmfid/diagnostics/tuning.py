"""Thresholds, limits and counts of `pmfid.diagnostics`, each with the decision that depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class DiagnosticTuning:
    """Thresholds and counts of `pmfid.diagnostics`, grouped by module."""

    # causality
    #: Smallest number of lags of the input. The next constants are the largest number of lags, the samples for each
    #: further lag, and the number of future lags.
    causality_least: int = 8
    causality_most: int = 40
    samples_per_lag: int = 15
    causality_ahead: int = 10
    #: Prediction of the input from its past. `own_past` and `short_past` are the numbers of past samples in the final
    #: and the first prediction. `causality_trials` is the number of subsets for the first prediction. Each prediction
    #: holds for `causality_block` samples. `causality_jump` is the size of a jump in robust standard deviations.
    own_past: int = 20
    short_past: int = 5
    causality_trials: int = 60
    causality_block: int = 500
    causality_jump: float = 4.5
    #: Number of passes of a robust fit, and of alternations between the noise fit and the regression.
    causality_passes: int = 4
    #: Relative size of a remainder below which the other columns explain a column up to rounding.
    causality_apart: float = 1e-7

    # drives
    #: Length of the judged part at the end of the record, in memories of an estimator with forgetting.
    drives_memories: float = 3.0

    # free_run
    #: Lengths of the free runs [s]. `free_run_worth` is the smallest ratio of a run to the stretch that determines its
    #: start. Shorter or longer records use the same lengths, scaled by powers of ten.
    free_run_horizons: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)
    free_run_worth: float = 2.0
    #: Largest number of runs for each horizon.
    most_runs: int = 200
    #: Smallest number of samples for each unknown in the fit of a start.
    free_run_samples: int = 4

    # processes
    #: Number of standard errors above which two values of a parameter are far apart.
    processes_far: float = 2.0
    #: Relative decrease of the sum of squares below which a step is unnecessary and a model is judged.
    processes_settled: float = 1e-6
    #: Greatest probability that a record of noise alone passes the test.
    noise_chance: float = 1e-2
    #: Probability of chance below which the colour of the noise has moved the estimate.
    processes_elsewhere: float = 1e-3
    #: Greatest part of the right models in open loop that a test of unmodelled effects, of feedback, or of the other
    #: hold rejects.
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


TUNING = DiagnosticTuning()
