"""Thresholds, limits and counts of `pmfid.fleet`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class FleetTuning:
    """One value for each decision of `pmfid.fleet`, by module."""

    # aside
    #: A file is mixed if reading it shard by shard takes more than this multiple of its rows.
    aside_times: int = 3
    #: Most rows in memory at a time while a file is set aside.
    aside_batch: int = 2**20

    # changes
    #: Relative error that segments of one axis share after a step, where the model is not quite the machine.
    changes_floor: float = 2e-3
    #: The step begins in the first segment with at least a part changes_part of the change and changes_sure standard
    #: deviations of it.
    changes_part: float = 0.05
    changes_sure: float = 5.0
    #: Such segments before the place that explains most, at most.
    changes_back: int = 2
    #: Part of its mean that a parameter with a trend has at the begin, at least: a line may go through zero.
    least_begin: float = 0.1
    #: Greatest number of segments: more are averaged in groups.
    changes_most: int = 128
    #: Distance between the middles of two sorts, and width of the empty gap between them, in their own spreads.
    changes_apart: float = 5.0
    changes_gap: float = 1.0
    #: Part of the axes that is a sort, at least: fewer are odd ones.
    least_part: float = 0.1

    # history
    #: Axes whose segments are in memory at once when they are judged.
    history_together: int = 64

    # plan
    #: [s].
    plan_day: float = 86_400.0
    #: Lengths of a slice [s], and how many samples it has at most.
    plan_lengths: tuple[float, ...] = (3600.0, 900.0, 180.0, 60.0, 15.0, 5.0, 1.0)
    most_samples: int = 2**19
    #: Slices whose rows are shared out together.
    plan_block: int = 24
    #: Rows of a shard: 40 bytes each, and as much again while they are sorted and estimated from.
    plan_budget: int = 2**22

    # rows
    #: A longer step, in medians of a slice, ends a piece, and the next sample starts a new one. Shorter gaps stay
    #: within a record.
    rows_apart: float = 8.5

    # segments
    #: Quarters of a whole segment. What is left at the end of a piece is one if it has two; all of a piece, if it has
    #: one.
    segments_whole: int = 4
    segments_rest: int = 2
    segments_least: int = 1
    #: Settling times of the filters from which on a rest is shortened, to two of them.
    segments_long: int = 4
    #: Settling times that few moves take with the ends of the rests on both sides, at least: the filters see of a
    #: shorter motion how it begins and ends alone, and repeated it has the same error again.
    segments_between: int = 3
    #: Part of its size that a parameter may be moved by: forces that are not there seem to move it by up to 2 % where a
    #: controller feeds the encoder's error back.
    segments_tolerance: float = 0.02
    #: Counts that a velocity is taken over, at least, at the usual speed.
    segments_counts: float = 4.0
    #: Greatest number of samples for a second look: they show what matters, and the look takes longer than the
    #: estimate.
    segments_most: int = 2**15
    #: Estimates of a segment that are kept.
    segments_marks: int = 16
    #: Range of the estimates after the first quarter that chance explains [standard deviations].
    segments_usual: float = 3.0
    #: Part of the second half in which the equation is off, from which on the segment is.
    segments_off: float = 0.25
    #: Part of the travel that goes the other way, at least; mean over largest size of an input of several sizes, at
    #: most.
    segments_back: float = 0.05
    segments_level: float = 0.98
    #: Samples of a batch at most [axes times samples].
    segments_batch: int = 2**22
    #: One segment in one_of of a piece has a second look.
    one_of: int = 16

    # series
    #: Batches whose means show what lasts, at least.
    series_batches: int = 4
    #: Standard deviations that segments are known to be too sure or unsure by, at least: of few, their own word counts.
    least_noise: float = 0.7
    series_few: int = 20
    #: Segments that tell what they share, at least.
    least_shared: int = 4
    #: Median of the absolute value of a normal number, in standard deviations.
    series_median: float = 0.6745
    #: A pause from which on a new run begins [s]; of long segments, as long as one.
    series_pause: float = 60.0
    #: Part of the segments of a second look that may be off, as a change lies in one of them.
    series_looks: float = 0.25
    #: Standard deviations, and part of their size, by which estimates of one direction and the others may differ.
    series_agrees: float = 4.0
    same_way: float = 0.02
    #: Sample periods within this part of one another are the same.
    series_same: float = 1e-3
    #: Part of imputed samples from which on a period reports them as missing.
    series_lost: float = 0.01

    # settings
    #: Lengths of a segment, one estimate, where the configuration has no memory of its own [s].
    settings_segments: tuple[float, ...] = (60.0, 120.0, 300.0, 600.0, 1800.0)
    #: The same in memories.
    settings_memories: float = 2.5
    #: Rests that are left out may lengthen a segment by this factor.
    settings_span: int = 10
    #: Length of a segment in settling times of the filters: usual and least.
    settings_settled: int = 20
    least_settled: int = 4
    #: Part of a piece whose samples may be missing.
    most_missing: float = 0.2
    #: Time constants of the filters that are tried [samples].
    settings_tried: tuple[int, int, int] = (10, 3, 30)
    #: Standard errors larger by this factor are an acceptable price of quicker filters.
    settings_cheap: float = 3.0
    #: Records that are looked at, and segments of each.
    settings_records: int = 8
    settings_most: int = 5

    # source
    source_nanosecond: float = 1e-9
    #: Columns that are listed where one is missing.
    source_listed: int = 30
    #: Most rows of a file in memory at a time; a row group may hold the whole file.
    source_window: int = 2**21
    #: Of a period [s].
    source_shortest: float = 1.0
    source_longest: float = 1e9

    # spark.block_files
    #: A file is looked through in pieces [bytes].
    block_files_piece: int = 2**24

    # spark.engine
    #: Rows that are handed to polars at once: Spark's own batches are small.
    at_once: int = 2**20
    #: Items of a job per processor, and the least number. Results are kept when a job is done; a job costs a tenth of a
    #: second. While the last items of a job are worked on, the next one has the other processors.
    engine_each: int = 4
    engine_least: int = 8
    engine_jobs: int = 2
    #: Processors that are reckoned with where Spark does not say how many it has.
    engine_untold: int = 64

    # spark.frame
    #: Greatest number of jobs: the results of a job are stored at its end, but each job reads its times again.
    frame_jobs: int = 16

    # spark.log
    #: Greatest part of the messages that is searched [bytes].
    log_lately: int = 2**20

    # spark.processor
    #: No byte of LZ4 becomes more of them.
    processor_most: int = 255

    # spark.stream
    #: Keys that are tried for each shard: one shard in e^30 has none among them.
    stream_tried: int = 30

    # verdicts
    #: Axes of a fleet without faults that each test may name by chance.
    by_chance: float = 0.3
    #: Standard deviations from which on the period of a step reports it, whatever the fleet is like.
    verdicts_clear: float = 6.0
    #: Axes of one type whose spread says what is unusual, at least.
    least_axes: int = 8
    #: Parts of the axes of a type whose distance from the median tells its spread: the rest may be odd.
    verdicts_parts: tuple[float, ...] = (0.5, 0.7, 0.8, 0.9)
    #: Segments that tell a step from wandering in any case, at least.
    verdicts_sure: int = 8
    #: Standard deviations of a step or trend below which nobody is named, so that nothing else need explain it.
    looked_at: float = 2.0
    #: Chance with which the line through an axis that wanders is a drift: of those that have a clear line only.
    verdicts_line: float = 1e-3


TUNING = FleetTuning()
