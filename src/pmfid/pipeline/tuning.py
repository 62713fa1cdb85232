"""Thresholds, limits and counts of `pmfid.pipeline`, each with the decision that depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class PipelineTuning:
    """Thresholds and counts of `pmfid.pipeline`, grouped by module."""

    # checks.counter
    #: Limits for a column that changes only every k rows. `counter_most` is the largest k, and `counter_least` is the
    #: smallest number of changes. `in_step` is the smallest part of the changes in step with k, or of the steps of a
    #: column that are whole multiples. Among the rows that are multiples of k, at least the part `counter_often` has a
    #: change.
    counter_most: int = 50
    counter_least: int = 30
    in_step: float = 0.98
    counter_often: float = 0.3

    # checks.inputs
    #: Number of values below which an input consists of steps, and of the values next to a limit that it is compared
    #: with.
    inputs_levels: int = 20
    #: Relative width of a level of a measured input, and largest part of the rows between the levels.
    one_level: float = 0.1
    one_level_rows: float = 0.02
    #: Smallest part of the record at a limit. `inputs_piled` is the smallest ratio of rows at the limit to rows at one
    #: of the nearest values.
    at_limit: float = 0.005
    inputs_piled: float = 5.0

    # checks.force
    #: Smallest correlation of a command with the output that it sets.
    force_alike: float = 0.9

    # checks.readings
    #: Greatest part of the input that a reading leaves unexplained. `readings_better` is the greatest ratio of the part
    #: that another reading leaves unexplained to the part that the given reading leaves.
    readings_follows: float = 0.15
    readings_better: float = 0.3
    #: Number of standard deviations above which a sign, or the mass of a reading, is certain. `readings_likely` is the
    #: number above which a sign is likely.
    readings_certain: float = 4.5
    readings_likely: float = 3.0
    #: Unexplained part above which a record says nothing about a sign.
    readings_unseen: float = 0.5
    #: Smallest time in which a mass reaches its speed [samples].
    readings_samples: float = 1.5
    #: Smallest duration of the motion in a reading, in time constants of the filters.
    readings_lasting: float = 10.0
    #: Smallest travel that shows gravity [rad]. A spring explains a shorter travel equally well.
    readings_turned: float = 1.0
    #: Smallest travel that shows a motion [counts].
    readings_fewest: int = 8

    # checks.timing
    #: Relative change of the velocity from sample to sample above which the sample period is too long. `timing_fine` is
    #: the number of counts per sample above which the encoder itself does not change the velocity by so much.
    timing_hasty: float = 0.42
    timing_fine: float = 3.0
    #: Time in which the velocity of a machine changes by its size [s]. A longer or a shorter time is doubted if the
    #: sample period is also beyond the periods of usual logs.
    timing_slowest: float = 1.0
    timing_fastest: float = 1e-4
    #: Counts per sample below which most samples carry no information. `timing_plenty` is a sufficient number of counts
    #: per sample.
    timing_idle: float = 0.02
    timing_plenty: float = 0.2

    # checks.view
    #: Smallest duration of a record in time constants. After slow filters, any columns explain a short record.
    view_enough: float = 60.0
    #: Smallest part of the travel in either direction if the motion has both directions.
    one_way: float = 0.05
    #: Spans that show the edges of a stop [samples]. `view_counts` is the smallest change of the motion at an abrupt
    #: edge [counts].
    view_spans: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    view_counts: int = 6
    #: Smallest ratio of the change of the motion at an abrupt stop to the largest change elsewhere.
    view_abrupt: float = 2.5
    #: Smallest number of samples in a stop, which is also the allowed delay of a motion, and smallest number of counts
    #: that the usual speed would bring during the stop.
    shortest_stop: int = 5
    view_missed: float = 4.0
    #: Force that moves an axis from rest, as a multiple of the friction.
    view_held: float = 2.2
    #: Largest number of filtered samples. The filters run over the samples with the most motion.
    view_most_samples: int = 8000

    # drives
    drives_chunk: int = 100_000
    #: Greatest part of the motion that a valid simulation leaves unexplained.
    drives_followed: float = 0.2

    # encoders
    #: Parts of a sample in the simulated motion, and positions of the disc for each encoder.
    encoders_parts: int = 10
    encoders_draws: int = 3
    #: Period of the timer of the edges [s].
    encoders_tick: float = 1e-6
    #: Increments per turn of the encoders for a rotary axis.
    encoders_increments: tuple[int, ...] = (16, 64, 256, 1024, 4096, 16384)
    #: Fewest steps in the travel of a linear axis, and decades of the steps.
    encoders_least_steps: float = 5.0
    encoders_decades: int = 4
    #: Largest relative distance of the simulated from the recorded motion without a note.
    encoders_missed: float = 0.3

    # guess.axis_file
    #: Most common sample period of an axis [s].
    axis_file_usual: float = 1e-3
    #: A step of an angle is a rounded part of a turn if the counts of a turn are this close to a whole number.
    whole_turn: float = 0.05

    # guess.columns
    #: Largest distance of a step from a multiple of another step.
    columns_exact: float = 0.02
    #: Largest rounding of a log relative to a step. With more rounding, any step would be possible.
    most_rounded: float = 0.15
    #: Smallest part of the rows with a value, and the part below which a column belongs to one of several topics.
    columns_filled: float = 0.1
    columns_topic: float = 0.7
    #: Number of steps in the range of a column without visible steps.
    columns_fine: int = 2**20

    # guess.instants
    #: Smallest part of the steps of a time column that grow or are even.
    columns_mostly: float = 0.9

    # guess.pairs
    #: Scores of a pair are logarithms of odds. `pairs_nothing` is the score of a log without an axis, and the weight
    #: from which on a name excludes other roles. A log without names needs a motion that explains two thirds of the
    #: input. `pairs_clear` is the weight of a clear name, and `pairs_computed` the weight of a word for a filtered
    #: value, or half of the weight of a word for a command.
    pairs_nothing: float = 2.0
    pairs_clear: float = 4.0
    pairs_computed: float = 1.0
    #: Weight of the logarithm of the unexplained part, which is at least `pairs_least`. Unmodelled friction leaves more
    #: of the input unexplained than noise does, so that the power of the rows counts for no more than two rows.
    pairs_motion: float = 2.0
    pairs_least: float = 0.02
    #: Weight of a relation that no input and output have.
    pairs_relation: float = 10.0
    #: Difference of scores beyond which another pair does not matter, and weight of a unit in a name. `pairs_sure` is
    #: the probability from which on a pair is written without a doubt, and `pairs_explained` the smallest explained
    #: part.
    pairs_certain: float = 6.0
    pairs_sure: float = 0.9
    pairs_explained: float = 0.3
    #: Largest number of tried pairs of an input and an output.
    most_pairs: int = 36
    #: Smallest travel of a joint, relative to the largest travel of any joint.
    least_travel: float = 0.05
    #: Greatest ratio of the part of the input that a pendulum leaves unexplained to the part that a plain drive leaves.
    #: A pendulum without gravity costs little, because its gravity is then estimated as zero.
    hanging_better: float = 0.8
    #: Largest travel of a pendulum whose angle has no unit [rad]. A column with a larger travel is not the angle of a
    #: pendulum.
    most_turned: float = 1000.0

    # guess.relations
    #: Largest difference of two sensors of one quantity, relative to their standard deviation, and largest distance of
    #: the gain of a set point from 1. `relations_follows` is the largest part of a set point that the output does not
    #: follow.
    relations_copy: float = 0.05
    relations_follows: float = 0.2
    #: Smallest jump of a column that is no motion, relative to its range, and smallest number of jumps in each
    #: direction.
    columns_jump: float = 0.4
    few_jumps: int = 3
    #: Smallest correlation of a column with the change of the output above which the column is the velocity and no
    #: input.
    columns_same: float = 0.99

    # guess.roles
    #: Weight of a unit that may stand for any quantity, as a voltage or a ratio on an oscilloscope.
    roles_analog: float = 1.5

    # monitored.run
    #: Largest number of outliers that are reported one by one.
    most_notices: int = 10

    # monitored.setup
    #: Memory [s] if [estimator] forgetting is 1, because an infinite memory would never follow a change.
    default_memory: float = 2.0
    #: Ratio of the standard deviations in normal work and in simulation above which the encoder is not the main noise.
    setup_noisy: float = 1.3
    #: Factor within which a reference record should determine the mean time between false alarms.
    setup_sure: float = 2.0

    # stored
    #: Largest number of letters of a text from a file in a message.
    longest_text: int = 150
    #: Relative difference below which a number in a file equals the configured number.
    stored_same: float = 1e-6

    # validation
    #: Multiple of the encoder's error below which a free run explains the counts.
    validation_within: float = 1.5


TUNING = PipelineTuning()
