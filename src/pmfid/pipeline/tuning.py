"""Thresholds, limits and counts of `pmfid.pipeline`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class PipelineTuning:
    """One value for each decision of `pmfid.pipeline`, by module."""

    # checks.counter
    #: Most rows between two changes; fewest changes; least part of the changes in step; least part of the rows in step
    #: with a change.
    counter_most: int = 50
    counter_least: int = 30
    in_step: float = 0.98
    counter_often: float = 0.3

    # checks.inputs
    #: An input of fewer values is one of steps.
    inputs_levels: int = 20
    #: Least part of the record at a limit; least ratio to the rows at one of the inputs_neighbours values next to the
    #: limit.
    at_limit: float = 0.005
    inputs_piled: float = 5.0
    inputs_neighbours: int = 20
    #: The missing force at the limit: least size in standard deviations; least size as a part of the largest force,
    #: times the part of the unexplained input that it removes; most that may stay unexplained of the input.
    inputs_certain: float = 4.0
    inputs_short: float = 0.008
    inputs_seen: float = 0.2
    #: Time constants of the filters that show the missing force [samples].
    times: tuple[float, ...] = (3.0, 10.0, 30.0, 100.0)

    # checks.force
    #: Least part of the travel in either direction of an axis that reverses; widths of means, which no step of an
    #: encoder outlives [samples].
    force_reverses: float = 0.2
    force_widths: tuple[int, ...] = (3, 9, 27, 81)
    #: Part of an unsigned input that may stay unexplained with the best signs, and in parts of what stays without;
    #: turns of the search for the signs.
    force_signed: float = 0.7
    force_better: float = 0.5
    force_turns: int = 10
    #: Least correlation of a command with the output that it sets.
    force_alike: float = 0.9

    # checks.readings
    #: Part of the input that a reading may leave unexplained, of all of it, and of what the record as it stands leaves.
    readings_follows: float = 0.15
    readings_better: float = 0.3
    #: The same for friction that no reading has. The input must then have the clock of the output, for an integral also
    #: follows an input of another clock.
    readings_loosely: float = 0.3
    #: Unexplained part below which, with a significant mass, no other reading is tried.
    readings_clearly: float = 0.001
    #: Standard deviations from which on a sign is certain, and from which on it is likely.
    readings_certain: float = 4.5
    readings_likely: float = 3.0
    #: Unexplained part above which a record says nothing about a sign.
    readings_unseen: float = 0.5
    #: Least time in which a body reaches its speed [samples]; if there is no body, the factor by which a velocity may
    #: leave more unexplained.
    readings_samples: float = 1.5
    readings_alike: float = 2.0
    #: Least duration of the motion of a reading, in time constants of the filters.
    readings_lasting: float = 10.0
    #: Change of the velocity from row to row, in parts of the velocity: of a column that is no position, and of one
    #: that may be.
    readings_rough: float = 0.6
    readings_smooth: float = 0.1
    #: Least travel that shows gravity [rad]: on a shorter one a spring does the same.
    readings_turned: float = 1.0
    #: Least travel from one end to the other [counts].
    readings_fewest: int = 8
    #: Least mass, in its standard deviations.
    readings_distinct: float = 2.0

    # checks.timing
    #: Largest shift that is tried, to either side [samples]; pieces of the record.
    largest_shift: int = 30
    timing_pieces: int = 16
    #: Least length of a piece, in multiples of the largest shift.
    timing_least: int = 2
    #: Largest drift over the whole record that is tried, to either side, and the step between drifts [samples].
    timing_furthest: float = 30.0
    timing_step: float = 0.5
    #: Change of the velocity from sample to sample, as a part of the velocity, above which samples miss the motion;
    #: counts per sample above which this change is not due to the encoder.
    timing_hasty: float = 0.42
    timing_fine: float = 3.0
    #: The same in records too short for filters; part of the change that the logged input leaves unexplained; least
    #: standard deviation of the change [counts]; least rows.
    timing_rather: float = 0.25
    timing_astray: float = 0.5
    timing_counts: float = 10.0
    timing_rows: int = 12
    #: Counts per sample below which most samples carry no information; counts per sample that suffice.
    timing_idle: float = 0.02
    timing_plenty: float = 0.2
    #: Time constants of the filters that show a drift [samples]; of a drift the least size [samples], the least size in
    #: standard deviations, and the largest ratio of the unexplained parts with and without it.
    drift_times: tuple[float, float, float] = (10.0, 30.0, 100.0)
    timing_drifted: float = 1.5
    timing_sure: float = 4.5
    timing_less: float = 0.95
    #: The same for the largest drift that is tried, which a motion by another joint asks for as well.
    timing_less_furthest: float = 0.5
    #: Most further corrections; largest corrected drift, as a multiple of the first.
    timing_corrections: int = 3
    timing_most: float = 1.5
    #: Samples that are searched for a drift.
    timing_most_samples: int = 40_000

    # checks.view
    #: Least duration of a record, in time constants: after slow filtering anything explains a short record.
    view_enough: float = 60.0
    #: Least part of the travel that goes back in a motion with both directions.
    one_way: float = 0.05
    #: Speed over which friction at rest falls, as a part of the usual speed.
    view_slow: float = 0.1
    #: Spans over which the edges of a stop are examined [samples]; least turn of the motion at an abrupt edge [counts].
    view_spans: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    view_counts: int = 6
    #: Least ratio of the turn of the motion at an abrupt stop to the largest turn elsewhere.
    view_abrupt: float = 2.5
    #: A stop that the axis leaves slowly or never: the factor by which its limit is higher. With view_several stops or
    #: more, its turn must also exceed view_abrupt times the median of all stops.
    view_dead: float = 2.0
    view_several: int = 3
    #: Least part of the record outside of stops for this comparison.
    view_apart: float = 0.2
    #: Least samples of a stop; least counts that the usual speed would have brought within it.
    shortest_stop: int = 5
    view_missed: float = 4.0
    #: Least part of the rows outside of stops: a column of steps has none.
    view_moving: float = 0.05
    #: An axis does not rest under a force above view_held times its friction, but for view_late samples, as with a dead
    #: time; the axis would have moved by FAR counts.
    view_held: float = 2.2
    view_late: int = 5
    view_far: float = 8.0
    #: Most stops that are examined, the longest first.
    view_most: int = 1000
    #: Samples of the part of a record that is filtered: the part with the most motion.
    view_most_samples: int = 8000

    # designs
    #: Largest limit, in any unit: no machine reaches it.
    most_limit: float = 1e100

    # drives
    #: Largest ratio of the unexplained part after integration to the unexplained part of the record as it is.
    drives_better: float = 0.5
    drives_chunk: int = 100_000
    #: A simulation follows the motion if it leaves at most this part of it unexplained.
    drives_followed: float = 0.2

    # friction
    #: Largest time constant of the filters that is chosen [samples]: after slower filters nearby speeds look alike.
    friction_slowest: int = 30

    # guess.axis_file
    #: Shortest, longest and most usual sample period of an axis [s].
    axis_file_shortest: float = 1e-5
    axis_file_longest: float = 0.1
    axis_file_usual: float = 1e-3

    # guess.columns
    #: Most values that are examined; least part of the steps that are whole multiples; largest distance from a
    #: multiple.
    columns_most: int = 20_000
    columns_part: float = 0.98
    columns_exact: float = 0.02
    #: Largest rounding of a log, as a part of a step: with more rounding any step would fit.
    most_rounded: float = 0.15
    #: Largest difference of a set point from the output, as a part of the output's deviation.
    columns_set_point: float = 0.1
    #: Least part of the rows with a value; part below which the rows of a column are those of one topic of several.
    columns_filled: float = 0.1
    columns_topic: float = 0.7
    #: Steps in the range of a column that shows no steps.
    columns_fine: int = 2**20
    #: Most pairs of an input and an output that are tried.
    most_pairs: int = 36
    #: Least travel of a joint, as a part of the largest travel of one.
    least_travel: float = 0.05
    #: Factor on what a joint explains if it seems to move against its torque: other joints then drive it.
    turned_joint: float = 0.5
    #: Part of what a plain drive leaves of the input that a pendulum may leave; least gravity in its standard
    #: deviations. A pendulum without gravity costs little: its gravity comes out as none.
    hanging_better: float = 0.8
    hanging_likely: float = 2.5
    #: Largest travel of an angle without a unit that may hang [rad]: a longer one is no pendulum's, or no angle.
    most_turned: float = 1000.0
    #: Least mass of a reading, in its standard deviations.
    columns_significant: float = 4.5
    #: Factor on the unexplained part of a reading that contradicts the column's name.
    columns_against: float = 3.0
    #: Least part of usual steps in a time column; largest relative deviation of a usual step from the median.
    columns_mostly: float = 0.9
    columns_even: float = 0.2
    #: Least jump of a column that is no motion, as a part of its range; least number of jumps in each direction.
    columns_jump: float = 0.4
    few_jumps: int = 3
    #: Least correlation of a column with the change of the output that makes it the velocity, and no input.
    columns_same: float = 0.99

    # monitored.lines
    #: Most sets of field names of one axis that are kept: names may have units in brackets.
    most_readings: int = 16
    #: Most letters of a message on a received value.
    most_letters: int = 200

    # monitored.run
    #: Most rows for the report; above it, every other row is dropped.
    most_rows: int = 8000
    #: Most notices of one kind of line, and of gaps; most events that are kept.
    most_notices: int = 10
    run_kept: int = 10_000

    # monitored.setup
    #: Memory if [estimator] forgetting is 1, which would never follow a change [s].
    default_memory: float = 2.0
    #: Ratio of the standard deviations of normal work and simulation above which the encoder is not the main noise.
    setup_noisy: float = 1.3
    #: Factor within which a reference record should determine the mean time between false alarms.
    setup_sure: float = 2.0

    # monitored.stream
    #: Most bytes of a line; a longer one counts as several bad lines.
    longest_line: int = 65536
    #: Lines at the beginning and at the end that must contain samples; least samples among the first ones.
    first_lines: int = 100
    least_samples: int = 10
    #: Most repetitions of every line by a logger.
    most_repeated: int = 3

    # monitored.timeline
    #: Steps from line to line in a group; least relative difference of their mean from the period that counts.
    timeline_steps: int = 25
    timeline_coarse: float = 0.05
    #: Longest step to a doubled line, which is no step [sample periods].
    timeline_doubled: float = 0.02
    #: Least part of regular steps in a group with a period; largest distance of a regular step from their mean.
    timeline_regular: float = 0.8
    timeline_close: float = 0.25
    #: Samples after which the mean period is checked; its largest relative error.
    timeline_long: int = 500
    timeline_fine: float = 0.005
    #: Largest deviation of the stamp of an expected sample [sample periods]: late stamps are commoner than lost ones.
    timeline_near: float = 0.75
    #: Share of a stamp's deviation that the grid takes over.
    timeline_follow: float = 0.1
    #: Successive lines that show missing samples, and a clock that was set back: a logger that repeats its last lines
    #: looks like the latter.
    timeline_ahead: int = 2
    timeline_late: int = 5
    #: Shortest and longest step from a held line to the next one [sample periods]; lines between may be lost.
    timeline_soonest: float = 0.25
    timeline_latest: float = 10.0
    #: Longest gap [s]; a longer one counts as a clock that was set.
    longest_gap: float = 3600.0
    #: Samples that a late line is compared with: an equal one is a repetition and no late sample.
    timeline_remembered: int = 32
    #: Successive lines without a fitting time that end the run.
    most_strays: int = 1000

    # stored
    #: Largest file that is read [bytes]: a result has some kilobytes.
    stored_largest: int = 10_000_000
    #: Most letters of a text from the file in a message.
    stored_longest: int = 150
    #: Relative difference below which a number from a file and a configured one are the same.
    stored_same: float = 1e-6

    # terms
    #: Part of the motion that counts as slow.
    terms_slow: float = 1 / 3

    # validation
    #: A free run explains the counts if its error is below this multiple of the encoder's error.
    validation_within: float = 1.5


TUNING = PipelineTuning()
