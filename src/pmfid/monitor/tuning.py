"""Thresholds, limits and counts of `pmfid.monitor`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class MonitorTuning:
    """All thresholds of `pmfid.monitor`, ordered by module."""

    # axis
    #: Time without informative blocks after which the state is CANNOT_TELL [s], and the least number of such blocks.
    silent_time: float = 2.0
    silent_blocks: int = 6
    #: Information, in average blocks, until the estimate after an alarm serves as a model, and then as a reference.
    model_information: float = 15.0
    reference_information: float = 60.0
    #: Information from which an estimate after a suspicion counts, in blocks or units.
    cause_information: float = 4.0
    #: Information at which the wait for an exclusion of further causes ends, in blocks and in units. If friction is
    #: small, only braking separates mass from gain. More units are no surer, because the evidence has the scatter of
    #: one unit (`python -m studies.alarms`).
    cause_blocks: float = 24.0
    cause_units: float = 8.0
    #: Largest information that counts for a single block, because a wrong model errs differently in each block.
    most_information: float = 1.5
    #: Share of the earlier information that the estimator keeps at the first suspicion.
    axis_keep: float = 0.003
    #: Part of the last rate, of the expected time of growth, or of the deviation, from which a slow change goes on. A
    #: change is slow if less than this part of the deviation is new.
    axis_pace: float = 0.5

    # chance
    #: Number of levels of the information of sums.
    chance_levels: int = 16
    #: Part of the maxima of the statistic below the compared one.
    chance_part: float = 0.98

    # edges
    #: Least number of tests that a false alarm comes in, and factor on standard errors of a doubtful estimate.
    edge_tests: float = 1e3
    edge_doubt: float = 3.0
    #: Relative error at the threshold above which no change shows, and least part of the reference at a restart.
    edge_known: float = 0.2
    edge_least: float = 1e-3
    #: Largest error of second order of an early estimate, relative to the change.
    edge_bend: float = 0.2
    #: Times in units of `silent_time`: until a cause is named without this, and until an unsure value is the reference.
    edge_confirmed: int = 2
    edge_settled: int = 10

    # calibration
    #: Least difference between the powers of a record and of its simulation that counts, in standard errors and as a
    #: ratio.
    calibration_larger: float = 3.0
    at_least: float = 1.3
    #: Information of a unit [average blocks]. The first size counts at which neighbouring units correlate by less than
    #: calibration_alike.
    calibration_sizes: tuple[float, float, float] = (16.0, 32.0, 64.0)
    calibration_alike: float = 0.3
    #: Least number of units for a scale.
    least_units: int = 100
    #: Part of the units of normal work that deviate within the limit.
    calibration_within: float = 0.97
    #: Number of passes that find limit and mean.
    calibration_passes: int = 5
    #: Least number of blocks in the simulation of a record, which gives thresholds to 3 %, and number of its parts.
    #: Each part begins at another phase of the encoder.
    calibration_blocks: int = 20_000
    calibration_phases: int = 8
    #: Least number of blocks in a record of normal work. The scatter of fewer blocks does not determine the noise.
    least_record_blocks: int = 8

    # cause
    #: Prior standard deviations of relative changes, with equal weights. The mixture is nearly flat over the logarithm
    #: of a size from 2 % to the fivefold, so that it prefers no size.
    cause_spreads: tuple[float, ...] = (0.05, 0.2, 0.8, 3.2)
    #: Prior odds of each further change at the same time.
    cause_further: float = 0.2
    #: Odds against a set that exclude it, which is strong evidence (Kass and Raftery 1995).
    cause_strong: float = 20.0
    #: Odds against a set that end the wait for more evidence. They are larger, because odds scatter and waiting is
    #: cheap: with 20, three times as many pairs of changes were taken for one (`python -m studies.alarms`).
    cause_clear: float = 30.0
    #: Number of blocks over which a change may be spread. The filters carry the change into the next block.
    cause_transition: int = 2

    # fleet
    #: Number of axes that are computed together, so that their arrays stay in the processor's cache.
    fleet_group: int = 256
    #: Number of samples in a piece. An axis that becomes suspicious is computed twice for the piece.
    fleet_piece: int = 100

    # monitor
    #: Change of the input over a gap, relative to its usual change over as many samples, above which the input has
    #: switched. The sample of the switch is unknown.
    monitor_switched: float = 6.0
    #: Share of samples with an unchanged input, and share of single changes, above which the input counts as held for
    #: several samples. An input that rests now and then is not held.
    monitor_held: float = 0.5
    monitor_alone: float = 0.9
    #: Relative error of the filtered input, by the unknown instant of a switch, above which the switch matters.
    monitor_doubtful: float = 0.01
    #: Largest number of guessed samples, and a further limit in time constants of the filters. The larger limit holds.
    monitor_few: int = 8
    monitor_short: float = 0.25
    #: Time in which the filters forget an impulse, in their time constants.
    monitor_forgotten: float = 4.5

    # scores
    #: Time until the model has the plant's velocity, in the plant's time constants, and its largest number of blocks.
    start_time_constants: float = 4.0
    most_start_blocks: int = 60
    #: Number of past units that an alarm examines, and over which maxima of the statistic are taken.
    look_back: int = 64

    # warmth
    #: Least friction relative to that at the mean temperature, because a line ends below zero far from it.
    warmth_least: float = 0.1
    #: Number of steps to the rate of friction. Each step removes about nine tenths of its error.
    warmth_passes: int = 4


TUNING = MonitorTuning()
