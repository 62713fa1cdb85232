"""Thresholds, limits and counts of `pmfid.records`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class RecordTuning:
    """One value for each decision of `pmfid.records`, by module."""

    # clock
    #: Sample periods of machine axes [s], the first included, the last excluded: drives log every 10 us to 100 ms.
    shortest_plain_period: float = 0.999e-5
    longest_plain_period: float = 0.1
    #: Seconds since 1970 at the beginning of 2000 and of 2100.
    clock_epochs: tuple[float, float] = (946_684_800.0, 4_102_444_800.0)
    #: Steps may differ from their median by this part without a note.
    clock_even: float = 0.1
    #: Steps that differ by less than this part are an even grid without a further test.
    clock_plain: float = 1e-6
    #: A step is a multiple of another one within this part.
    clock_whole: float = 0.01
    #: Largest deviation of a stamp from an even grid by chance [sample periods].
    clock_furthest: float = 0.9
    #: Stamps that are averaged to detect a missing sample; largest mean by chance, in standard deviations.
    clock_group: int = 50
    most_by_chance: float = 5.0
    #: A period and a time column agree within this part.
    clock_same: float = 0.01
    #: Longest step without a missing sample, in medians.
    clock_missing: float = 1.5
    #: Largest distance of a step from a whole number of periods on an even grid [periods].
    clock_near: float = 0.3
    #: Longest step that determines the period [periods]: a pause need not be a whole number.
    clock_short: int = 5
    #: Relative accuracy of the period.
    clock_settled: float = 1e-9
    #: Largest standard deviation of stamps around a grid [periods]; random stamps have 0.29.
    clock_scatter: float = 0.2
    #: A row within clock_early periods after another one is odd if no larger part of the rows than clock_rare is.
    clock_early: float = 0.3
    clock_rare: float = 0.001
    #: Most iterations between grid and places.
    clock_turns: int = 5
    #: Least part of the steps of a grid that are single periods.
    clock_single: float = 0.3
    #: Least number of long steps for a distinction of missing lines and rounded stamps. After one or two pauses the
    #: output says too little.
    long_steps: int = 5
    #: Longest gap on the grid [samples]. Longer gaps are shortened: the motion restarts after a gap of any length.
    clock_longest: int = 1000

    # filling
    #: Variance of a count [counts^2].
    filling_count: float = 1 / 12
    #: Information on position and velocity before the record [1/counts^2, s^2/counts^2]: practically none.
    filling_nothing: float = 1e-12
    #: Right-hand sides that are solved at once.
    filling_chunk: int = 256
    #: Most iterations of estimate and filling: the filled samples hardly change the estimate.
    filling_turns: int = 3
    #: Relative change of the parameters below which the iteration ends.
    filling_settled: float = 1e-4
    #: Error of the velocity at an event by wrong parameters, as a part of the root mean square velocity: before and
    #: after the inputs are found.
    filling_wrong: tuple[float, float] = (1e-2, 1e-3)
    #: The same limit for the position [counts].
    filling_shift: float = 0.1
    #: Interval of further events, in filter time constants and in samples: a deviation is as smooth as the motion.
    filling_often: float = 2.0
    filling_fewest: int = 8
    #: Seed of the samples that `doubt` removes.
    filling_again: int = 16
    #: Largest standard deviation of a known instant [samples].
    filling_known: float = 0.25
    #: Largest distance of the deviation in a gap from the line between its neighbours [counts].
    filling_within: float = 1.0

    # gaps
    #: Samples farther away than gaps_near times `half` lie beyond another gap and have the weight far_weight.
    gaps_near: float = 3.0
    far_weight: float = 1e-6
    #: Most and fewest samples that are left out for the error; missing samples that are filled at once.
    gaps_most: int = 1000
    gaps_fewest: int = 30
    gaps_chunk: int = 20_000
    #: Least part of the samples in which a held input does not change.
    gaps_held: float = 0.5
    #: Quantile of the times for which a held input keeps its values; shorter gaps are filled.
    gaps_shortest: float = 0.02
    #: Lengths of gaps [samples] that may be filled.
    gaps_lengths: tuple[int, ...] = (1, 2, 3, 5, 8, 12, 20, 30, 50, 100)
    #: Largest error of the interpolated mean input over a gap, as a part of the root mean square input.
    gaps_faithful: float = 0.1
    #: If more than the part gaps_scattered of the samples stays missing, gaps of up to gaps_always samples are filled
    #: in any case: between scattered gaps no motion could restart.
    gaps_always: int = 8
    gaps_scattered: float = 0.02
    #: Samples without input between two joined records.
    gaps_apart: int = 20

    # joining
    #: Largest relative difference of sample periods, which tolerances of clocks explain.
    joining_same_period: float = 1e-3

    # outliers
    #: Once the wrap is undone: largest change, as a part of the range; largest roughness, as a part of the former one.
    outliers_room: float = 0.25
    outliers_smoother: float = 0.1
    #: Jumps of one size differ by at most this part of it.
    outliers_alike: float = 0.05
    #: Largest relative distance of a range from whole turns.
    whole_turns: float = 0.005
    #: Largest width of a counter; least range of the counts, for over fewer any motion may look like a jump.
    most_bits: int = 32
    outliers_least: int = 8
    #: Changes of the counts in the window of the median that predicts one change. The median follows a velocity that
    #: steps, and five wrong changes in a row do not move it. Steps of the velocity are searched in the same window.
    outliers_around: int = 11
    #: Allowed deviation from the median [counts], and as a multiple of the usual deviation plus the step of the
    #: velocity.
    outliers_counts: float = 10.0
    outliers_times: float = 4.0
    #: Quantile of the deviations that counts as usual.
    outliers_usual: float = 0.95
    #: Shortest step, in periods, of a clock whose changes of the counts are judged as speeds.
    outliers_pace: float = 0.25
    #: Most passes: wrong changes close together hide each other.
    outliers_passes: int = 4
    #: Largest part of wrong changes; above it, the errors are not single samples.
    most_changes: float = 0.04
    #: Least ratio of a spike to the quantile 1 - most_inputs of the input; answer of the velocity, as a multiple of its
    #: usual change over answer_samples samples, above which the input is no spike.
    outliers_spike: float = 50.0
    outliers_answer: float = 3.0
    answer_samples: int = 10
    most_inputs: float = 0.01
    #: Windows that are sorted at once: the windows of a long record need eleven times its memory.
    outliers_chunk: int = 65_536
    #: Rows that a sentence names.
    outliers_named: int = 4

    # record
    #: Largest distance of a velocity from a multiple of a step, as a part of the step.
    record_whole: float = 1e-3
    # Beyond 2**53 neighbouring integers share one float64, and a count would be silently wrong.
    max_count: float = 2.0**53
    #: Rows that are tested for counts; whole numbers without exception, and more of them than this differ, are counts.
    record_distinct: int = 10_000
    most_whole: int = 20
    min_samples: int = 10

    # repeats
    #: Counts in a row before and after one without any: no motion stops and goes on like that.
    repeats_sudden: float = 3.0
    #: Rows with one value; more are a stop, or a sensor that is stuck. The second: unless the next value catches up.
    repeats_longest: int = 8
    repeats_longest_slow: int = 4
    #: Fewest such rows, and their least and most part of the fast ones: a single one is a wrong reading, and an output
    #: that is held in every other row has a remedy of its own.
    repeats_fewest: int = 5
    repeats_part: float = 0.005
    repeats_most: float = 0.5
    #: A repeated value is off by more than this [steps of the encoder]; below it, it is as good as the new one.
    repeats_off: float = 0.75
    #: Of the range of the input: a change by more is a jump.
    repeats_jump: float = 0.2

    # resampling
    #: Steps that differ from their median by less than this part are taken as even.
    even_steps: float = 0.02
    #: Standard errors by which the output must tell whether stamps are the instants of the samples, and the part of the
    #: rows that it is asked in: the others may be wrong readings.
    resampling_errors: float = 2.0
    resampling_plain: float = 0.99
    #: A step beyond this many usual ones is a gap: nothing is interpolated across a gap.
    longest_step: float = 3.5
    #: The same where rows with an old output were left out, whose input is known.
    longest_between_repeats: float = 8.5
    #: Part of the steps, the shortest ones, whose mean is usual.
    resampling_usual: float = 0.98
    #: Length of a record in median steps, as a multiple of its samples, from which on missing lines do not explain it.
    most_missing: float = 2.0
    #: Two halves of a record agree on the period within this part: half of it is an error of the mass that matters.
    resampling_same_period: float = 0.01
    #: Fewest samples for a decision.
    #: Of a period, within which a sample is followed at once: it holds for nothing.
    resampling_at_once: float = 1e-3
    resampling_fewest: int = 50
    # topics
    #: Part of the rows that may have both values if input and output have rows of their own; least rows of each.
    most_together: float = 0.05
    topics_fewest: int = 10


TUNING = RecordTuning()
