"""Thresholds, limits and counts of `pmfid.monitor`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class MonitorTuning:
    """One value for each decision of `pmfid.monitor`, by module."""

    # axis
    #: Time without informative blocks after which the state is CANNOT_TELL [s], and the least number of such blocks.
    silent_time: float = 2.0
    silent_blocks: int = 6
    #: Information, in average blocks, until the estimate after an alarm serves as a model, and then as a reference.
    model_information: float = 15.0
    reference_information: float = 60.0
    #: Information after which a cause is named if all others are excluded, and after which the most likely one is: if
    #: there is no estimate, and if there is one. If friction is small, only braking separates mass from gain.
    cause_information: float = 4.0
    cause_blind: float = 16.0
    cause_latest: float = 32.0
    #: Information of a single block counts up to here: a wrong model errs in each block in another way.
    most_information: float = 1.5
    #: Share of the earlier information that the estimator keeps at the first suspicion.
    axis_keep: float = 0.003

    # calibration
    #: Lengths of sums that are compared [blocks]; the longest is what the detectors look back on.
    calibration_lengths: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    #: Units of a piece, and what more of them may change the variance of their sum by.
    calibration_pieces: tuple[int, ...] = (1, 2, 4, 8, 16)
    calibration_same: float = 0.1
    #: Excess of a record's power over the simulated one that counts: in standard errors, and as a ratio.
    calibration_larger: float = 3.0
    at_least: float = 1.3
    #: Information of a unit [average blocks]; the first size at which neighbouring units correlate by less than
    #: calibration_alike.
    calibration_sizes: tuple[float, float, float] = (16.0, 32.0, 64.0)
    calibration_alike: float = 0.3
    #: Least units for a scale.
    least_units: int = 100
    #: Part of the units of normal work that deviate within the limit.
    calibration_within: float = 0.97
    #: Passes in which limit and mean are found.
    calibration_passes: int = 5
    #: Length of one simulated run [s], and of the intervals whose maxima are counted.
    run_time: float = 1800.0
    interval_time: float = 30.0
    #: Simulated time, in asked times between false alarms, and its limits [h].
    hours_per_mtbf: float = 4.0
    least_hours: float = 20.0
    most_hours: float = 100.0
    #: Number of maxima to which the line of the tail is fitted.
    calibration_tail: int = 100
    #: Difference of a record's noise from the simulated noise, in standard errors, from which the record's noise is
    #: used.
    calibration_noisier: float = 3.0
    #: Hours of resampled work for each hour of simulated work, and the number of runs into which these hours are
    #: divided.
    calibration_resampled: float = 4.0
    calibration_runs: int = 64
    #: Parts of a record whose thresholds are compared, and how much rarer than asked alarms are made at most, by what
    #: the record leaves in doubt: less often is better than more often.
    calibration_parts: int = 4
    calibration_careful: float = 2.0
    #: Discount of a unit of work in the memory of `ChiSquare`.
    unit_keep: float = 0.85
    #: A simulated machine that goes further runs away [counts].
    most_counts: float = 2.0**53
    #: Blocks that a simulated run must have.
    least_blocks: int = 200
    #: Least blocks of a record of normal work: the scatter of fewer does not determine its noise.
    least_record_blocks: int = 8

    # cause
    #: Keeps the instruments of a few blocks apart.
    cause_ridge: float = 1e-6
    #: Blocks that a change may be spread over: the one it falls into, and the one whose filters remember that.
    cause_transition: int = 2
    #: Least information, in average blocks, that remains for the size when these blocks are left out.
    least_information: float = 2.0
    #: A cause is excluded if it leaves this much more of the estimate's deviation unexplained than another cause does
    #: [squared standard errors]: three standard errors.
    cause_excluded: float = 9.0
    #: Relative error of a size from blocks in addition to its standard error: the simulated motion reverses at other
    #: instants than the changed plant.
    cause_moved: float = 0.05
    #: Number of neighbours with which the deviation of a block correlates.
    cause_lags: int = 2

    # fleet
    #: Axes that are computed at once: their arrays stay in the processor's cache.
    fleet_group: int = 256
    #: Samples of a piece: an axis that becomes suspicious goes through it twice.
    fleet_piece: int = 100

    # monitor
    #: Change of the input over lost samples, relative to its usual change over as many samples, from which it has
    #: switched in one of them. Which one is unknown.
    monitor_switched: float = 6.0
    #: An input that is the same as before in more than this part of the samples, and of whose changes more than that
    #: part come alone, is held for several of them; one that rests now and then is not.
    monitor_held: float = 0.5
    monitor_alone: float = 0.9
    #: Relative error of the filtered input, by the unknown instant of a switch, from which the switch matters.
    monitor_doubtful: float = 0.01
    #: Most missing samples that are guessed, and the same in time constants of the filters; the larger one holds.
    monitor_few: int = 8
    monitor_short: float = 0.25
    #: Time in which the filters forget an impulse, in their time constants.
    monitor_forgotten: float = 4.5

    # scores
    #: Time until the model's velocity is the plant's, in the plant's time constants, and the most blocks of it.
    start_time_constants: float = 4.0
    most_start_blocks: int = 60
    #: Number of past units that an alarm examines.
    look_back: int = 64


TUNING = MonitorTuning()
