"""Thresholds, limits and counts of `pmfid.fleet`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class FleetTuning:
    """All thresholds of `pmfid.fleet`, ordered by module."""

    # changes
    #: Relative error that segments of one axis share after a step, because the model differs slightly from the machine.
    changes_floor: float = 2e-3
    #: A step begins in the first segment whose change has `changes_part` of the whole size and `changes_sure` standard
    #: deviations.
    changes_part: float = 0.05
    changes_sure: float = 5.0
    #: Largest number of segments between the beginning of a step and the place that explains most.
    changes_back: int = 2
    #: Least begin of a parameter with a trend, as a part of its mean, because a line may go through zero.
    least_begin: float = 0.1
    #: Largest number of segments. More segments are averaged in groups.
    changes_most: int = 128
    #: Distance between the middles of two kinds, and width of the empty gap between them, in their own spreads.
    changes_apart: float = 5.0
    changes_gap: float = 1.0
    #: Least part of the axes that makes a kind. Fewer axes are outliers.
    least_part: float = 0.1

    # missing_forces
    #: Plausible sizes: a gain that falls at the usual input, or friction beyond viscous friction at the usual speed,
    #: and friction at rest beyond Coulomb friction, each as a part. `slow_speed` is the usual Stribeck speed as a part
    #: of the usual speed.
    bends: float = 0.15
    friction_at_rest: float = 0.3
    slow_speed: float = 0.1
    #: Part of its size by which a missing force, or the direction of motion, may move a parameter without a report.
    model_tolerance: float = 0.02

    # local
    #: Number of rows that all threads have in memory together, and least number of one thread. A row takes 40 bytes,
    #: and as much again while rows are sorted and estimates computed.
    plan_rows: int = 2**22
    plan_least: int = 2**18
    #: Number of chunks with rows of one part above which the rows are sorted first, because each chunk reads the part.
    plan_times: int = 3
    #: Free space below which a failed write means a full disk [bytes].
    plan_free: int = 2**24

    # rows
    #: Longest step within a piece, in medians of an hour. After a longer step, the next sample starts a new piece.
    #: Shorter gaps stay within a record.
    rows_apart: float = 8.5

    # segments
    #: Number of quarters in a whole segment, and in a further segment at the end of a piece.
    segments_whole: int = 4
    segments_rest: int = 2
    #: Length of a rest above which two settling times replace it, and least length of a segment, in settling times of
    #: the filters.
    segments_long: int = 4
    #: Least duration of a few moves with the ends of the rests on both sides, in settling times. Of a shorter motion
    #: the filters see only begin and end. Repetitions of one motion have the same error.
    segments_between: int = 3
    #: Least number of counts over which a velocity is computed, at the usual speed.
    segments_counts: float = 4.0
    #: Largest number of samples that are searched for missing forces. The search takes longer than the estimate.
    segments_most: int = 2**15
    #: Number of estimates of a segment that are kept.
    segments_marks: int = 16
    #: Range of the estimates after the first quarter that chance explains [standard deviations].
    segments_usual: float = 3.0
    #: Part of the second half with a wrong equation from which the segment counts as wrong.
    segments_off: float = 0.25
    #: Least part of the travel in the other direction. `segments_level` is the largest ratio of mean and maximum of an
    #: input with several sizes.
    segments_back: float = 0.05
    segments_level: float = 0.98
    #: Largest number of samples that are estimated at once. All results of samples with edge times are in memory.
    segments_batch: int = 2**18
    #: Step of the time, in median steps, at which a row with an edge may be missing, and least number of samples.
    edges_apart: float = 1.5
    edges_least: int = 100
    #: One segment in `one_of` of a piece is searched for missing forces.
    one_of: int = 16

    # series
    #: Least number of batches whose means reveal a lasting deviation, and of segments that reveal their shared scatter.
    series_batches: int = 4
    #: Least factor by which the scatter of segments may correct their standard errors. `series_few` is the least number
    #: of segments for a correction below 1.
    least_noise: float = 0.7
    series_few: int = 20
    #: Largest allowed difference between estimates from opposite directions, in standard deviations.
    series_agrees: float = 4.0
    #: Relative difference within which sample periods count as equal.
    series_same: float = 1e-3
    #: Part of imputed samples above which a period reports missing samples.
    series_lost: float = 0.01

    # settings
    #: Usual length of a segment [s], if the configuration has no memory of its own, and least pause before a new run.
    settings_segment: float = 60.0
    #: Length of a segment in memories of the estimator.
    settings_memories: float = 2.5
    #: Factor by which omitted rests may lengthen a segment.
    settings_span: int = 10
    #: Usual length of a segment, in settling times of the filters.
    settings_settled: int = 20
    #: Largest part of missing samples in a piece.
    most_missing: float = 0.2
    #: Largest number of axes whose first hour may decide.
    tried_axes: int = 25

    # source
    #: Shortest length of a period [s].
    source_shortest: float = 1.0

    # verdicts
    #: Number of axes that each test may name by chance in a fleet without faults.
    by_chance: float = 0.3
    #: Standard deviations of a step above which its period reports the step without regard to other axes.
    verdicts_clear: float = 6.0
    #: Parts of the axes of a type whose distance from the median gives the spread. The remaining axes may be outliers.
    verdicts_parts: tuple[float, ...] = (0.5, 0.7, 0.8, 0.9)
    #: Least number of segments that always separate a step from wandering, and of axes of one type whose spread reveals
    #: an unusual axis.
    verdicts_sure: int = 8
    #: Standard deviations of a step or trend below which no axis is named, so that no other explanation is needed.
    looked_at: float = 2.0
    #: Chance that the line through a wandering axis is taken for a drift, among axes with a clear line.
    verdicts_line: float = 1e-3


TUNING = FleetTuning()
