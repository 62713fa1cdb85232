"""Thresholds, limits and counts of `pmfid.records`, each with the decision that depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class RecordTuning:
    """Thresholds and counts of `pmfid.records`, grouped by module."""

    # clock
    #: Range of the sample periods of machine axes [s], as drives log every 10 us to 100 ms. A longer period is slow for
    #: any axis. A name with a unit is believed up to `longest_named_period`.
    shortest_plain_period: float = 0.999e-5
    longest_plain_period: float = 0.1001
    longest_named_period: float = 1.001
    #: Seconds since 1970 at the beginning of 2000 and of 2100.
    clock_epochs: tuple[float, float] = (946_684_800.0, 4_102_444_800.0)
    #: Relative deviation of steps from their median that needs no note.
    clock_even: float = 0.1
    #: Largest deviation of a stamp from an even grid by chance [sample periods].
    clock_furthest: float = 0.9
    #: Fewest stamps for a decision, and number of averaged stamps that reveal a missing sample. The next constants are
    #: the largest and the least number of blocks of stamps, whose means show the scatter of stamps that are late
    #: together, and the largest mean by chance, in standard deviations.
    clock_group: int = 50
    clock_blocks: int = 30
    clock_least_blocks: int = 4
    most_by_chance: float = 5.0
    #: Relative difference of the longest and shortest step of a clock, or of the periods of two records, that needs
    #: neither a note nor a further test. Tolerances of clocks explain it.
    clock_same_steps: float = 1e-3
    #: Relative difference within which periods agree, of a configuration, a time column or the halves of a record, or a
    #: step and a multiple of another step. Even half of the limit causes a significant error of the mass.
    clock_same: float = 0.01
    #: Longest step without a missing sample, in median steps.
    clock_missing: float = 1.5
    #: Largest distance of a step from a whole number of periods on an even grid, and time after a row within which a
    #: following row is too early [periods]. `clock_rare` is the greatest part of rows that are too early.
    clock_near: float = 0.3
    clock_rare: float = 0.001
    #: Longest step that determines the period [periods], because a pause may have a fractional length.
    clock_short: int = 5
    #: Largest standard deviation of stamps around a grid [periods]. Random stamps have a standard deviation of 0.29
    #: periods.
    clock_scatter: float = 0.2
    #: Largest distance of the earliest stamp from the mean of late stamps, in standard deviations. A half-normal delay
    #: has 1.3. Sorted stamps with a delay of 2 periods have 2.2, from where on both lines are alike. Errors in both
    #: directions have more than 3.
    clock_lowest: float = 2.3
    #: Largest number of lines that are tried below all stamps, and of iterations between grid and places. A few
    #: suffice.
    clock_turns: int = 50
    #: Smallest number of long steps that distinguishes missing lines from rounded stamps, and of rows that repeat an
    #: output. The output at only one or two pauses says too little, and a single repeated row is a wrong reading.
    long_steps: int = 5
    #: Longest gap on the grid [samples]. Longer gaps are shortened, because the motion restarts after any gap.
    clock_longest: int = 1000
    #: Largest number of periods in a step, for sums without an overflow.
    clock_most: float = 2.0**40

    # gaps
    #: Smallest part of the samples in which a held input does not change.
    gaps_held: float = 0.5
    #: Quantile of the times for which a held input keeps its values. Gaps shorter than this quantile are filled.
    gaps_shortest: float = 0.02
    #: Length of gaps that straight lines bridge where no motion can restart after each [samples].
    gaps_bridged: int = 8

    # outliers
    #: Largest change after unwrapping, relative to the range. `outliers_smoother` is the largest ratio of the roughness
    #: after unwrapping to the roughness before.
    outliers_room: float = 0.25
    outliers_smoother: float = 0.1
    #: Largest relative difference between jumps of equal size.
    outliers_alike: float = 0.05
    #: Largest relative difference between a range and a whole number of turns.
    whole_turns: float = 0.005
    #: Largest width of a counter [bits]. `outliers_least` is the smallest range of the counts, because within a smaller
    #: range any motion may resemble a jump.
    most_bits: int = 32
    outliers_least: int = 8
    #: Smallest ratio of a spike to the quantile 1 - most_inputs of the input. The input is no spike if the velocity
    #: responds by more than a multiple of its usual change over answer_samples samples.
    outliers_spike: float = 50.0
    outliers_answer: float = 3.0
    #: Quantile of the changes of velocity that counts as usual.
    outliers_usual: float = 0.95
    answer_samples: int = 10
    most_inputs: float = 0.01
    #: Number of rows that a sentence names.
    outliers_named: int = 4

    # record
    #: Largest relative distance of a velocity from a multiple of a step, or of the step of a column from a resolution.
    #: Logs have at least three digits. Differences of a column below `record_rounding` of its step come from its binary
    #: rounding.
    record_whole: float = 1e-3
    record_rounding: float = 1e-6
    # Limit of counts, because neighbouring integers beyond 2**53 share one float64 and a count would be silently wrong.
    max_count: float = 2.0**53
    #: Largest number of a column. No unit of any quantity needs more.
    largest_number: float = 1e100
    #: Number of rows that are tested for steps and counts. A column holds counts if all tested numbers are whole and
    #: more than `most_whole` of them are distinct.
    record_distinct: int = 20_000
    most_whole: int = 20
    min_samples: int = 10

    # repeats
    #: Smallest number of counts in the rows before and after a row without counts. No real motion has such a sudden
    #: stop.
    repeats_sudden: float = 3.0
    #: Largest number of rows with one value. More rows are a stop or a stuck sensor. `repeats_longest_slow` is the
    #: limit if the next value does not catch up.
    repeats_longest: int = 8
    repeats_longest_slow: int = 4
    #: Smallest and greatest part of the fast rows that repeat an output. An output that is held in every second row has
    #: its own remedy.
    repeats_part: float = 0.005
    repeats_most: float = 0.5
    #: Smallest error of an old value [steps of the encoder]. A value with a smaller error is as good as a new value.
    repeats_off: float = 0.75

    # resampling
    #: Relative deviation of steps from their median below which the steps are even.
    even_steps: float = 0.02
    #: Smallest part of the steps that differ from their neighbours on an uneven clock with gaps.
    resampling_often: float = 0.2
    #: Number of standard errors for a decision whether stamps are the instants of the samples.
    resampling_errors: float = 2.0
    #: Longest step in usual steps. A longer step is a gap without interpolation.
    longest_step: float = 3.5
    #: Part of the steps, the shortest ones, whose mean is the usual step.
    resampling_usual: float = 0.98
    #: Ratio of a record's length in median steps to its number of samples above which missing lines do not explain the
    #: length.
    most_missing: float = 2.0
    #: Part of the period within which the next sample follows at once, so that the input of the first sample acts for
    #: no time.
    resampling_at_once: float = 1e-3

    # topics
    #: Greatest part of the rows with both values if input and output have separate rows.
    most_together: float = 0.05


TUNING = RecordTuning()
