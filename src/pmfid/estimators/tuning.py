"""Thresholds, limits and counts of `pmfid.estimators`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class EstimatorTuning:
    """Thresholds, limits and counts of `pmfid.estimators`, by module."""

    # adequacy
    #: Smallest assumed Coulomb friction of a machine, as a part of the motor's force.
    least_friction: float = 0.02
    #: Stribeck friction is averaged over parts of a sample, because it changes within a fraction of a sample at a
    #: reversal. The first value is the largest change of velocity within a part, as a fraction of the Stribeck speed.
    #: The second value is the largest number of parts.
    adequacy_fine: float = 0.1
    most_parts: int = 16
    #: A smaller change of velocity, as a part of the Stribeck speed, counts as zero.
    adequacy_steady: float = 1e-3
    #: Plausible sizes of unmodelled effects, as parts of Coulomb friction, viscous friction, the motor's force, a
    #: sample, and the largest input.
    adequacy_stribeck: float = 0.3
    adequacy_uneven: float = 0.15
    adequacy_curved: float = 0.15
    late_by: float = 0.5
    dead_zone: float = 0.03
    #: Parts of the largest input at which an amplifier may begin to give less.
    adequacy_kinks: tuple[float, float, float] = (0.5, 0.7, 0.9)
    #: The model misses a force if the force's score exceeds this number of standard deviations. Chance does so once in
    #: a thousand records.
    adequacy_missed: float = 4.0
    #: A finding also names each force that explains at least this part of what the best force explains. The second
    #: value is the largest number of named forces.
    adequacy_nearly: float = 0.8
    most_said: int = 3
    #: Number of parts of a record. Each part tests the force that the other parts show.
    adequacy_parts: int = 6
    #: A part of a record says nothing about a force below this part of the information on the force.
    adequacy_rare: float = 1e-6
    #: Two estimates contradict each other from this number of standard deviations of their difference.
    adequacy_contradicted: float = 2.5
    #: Nothing can be said about a force if less than this part of its effect is independent of the parameters' effects.
    adequacy_apart: float = 1e-4
    #: Steps of a force in the simulation, for its derivative: a part of the plausible size, and a part of the motor's
    #: force.
    adequacy_step: float = 0.1
    step_of_force: float = 1e-3

    # auxiliary
    #: Time constant of the estimate's slow copy, which drives the model, in filter time constants. The instruments must
    #: not follow the noise of the samples that they are multiplied with.
    copy_time_constants: float = 17.0
    #: The model is not trusted if the mean square error of its velocity exceeds this part of the mean square velocity.
    mismatch_limit: float = 0.2
    #: Value for equations with shapes. With 3 the first samples still mattered after 4000 samples; with 7 the error
    #: bars were longer.
    growing_with_shapes: int = 5
    #: Memory of the comparison between the model's and the measured velocity, in filter time constants.
    check_time_constants: float = 30.0
    #: Memory of the comparison that reveals a model ahead of the plant, in filter time constants. The second value is
    #: the span of samples for one comparison, in the same unit.
    lag_time_constants: float = 1000.0
    alike_time_constants: float = 2.0
    #: The equation is called wrong on-line if the mean square innovation exceeds this multiple of a white encoder
    #: error. The second value is the length of the two compared stretches, in filter time constants.
    auxiliary_unexplained: float = 2.5
    model_check_time_constants: float = 50.0

    # base
    max_settle_samples: int = 10**8
    #: Shortest and longest sample period [s].
    base_shortest: float = 1e-12
    base_longest: float = 1e12
    #: Value in place of a smaller cutoff * dt, which is refused, because its results exceed float64.
    least_product: float = 1e-300
    #: Number of updates from the accumulated right-hand side. Later updates move theta by the innovation alone. float64
    #: without forgetting never changes over.
    residual_updates: int = 256

    # batch
    #: A target that is closer to one regressor alone, relative to its size, identifies no other parameter.
    target_apart: float = 1e-6
    tiny: float = 1e-300
    #: Largest number whose square stays within the format.
    batch_beyond: float = 1e120

    # cutoff
    #: Tried time constants of the filters [samples]. A longer one averages the encoder's error more, and a shorter one
    #: keeps more information on the mass. The first with an estimate gives the motion by which all are judged.
    cutoff_tried: tuple[int, ...] = (10, 30, 3, 100, 300)
    #: Filter time constants in the shortest record.
    cutoff_least: int = 30
    #: Filter time constants in the shortest on-line memory, and samples in the longest filter time constant. With
    #: slower filters, the recursion forgets its information before it may trust its instruments, and mostly falls back.
    #: On most axes from 3e-5 kg m2 to 500 kg, 30 samples were the best value.
    cutoff_remembered: int = 3
    cutoff_slowest: int = 30

    # instruments
    instruments_max_iterations: int = 40
    instruments_tolerance: float = 1e-7
    #: Pass from which on steps are halved. A stop of the model that comes and goes with theta keeps the iteration in a
    #: small cycle.
    damped_from: int = 15
    #: Relative size up to which such a cycle counts as converged.
    instruments_accepted: float = 2e-3
    #: A parameter may be zero if its term is less than this part of the target. The change of such a parameter is
    #: measured against this part.
    instruments_small: float = 1e-2
    #: Length of a record's first part, in which the model's velocity forgets its unknown start.
    start_part: float = 0.05
    #: Samples with equal counts at the start of a record that may begin at rest.
    rest_samples: int = 5
    #: Relative step of the difference quotients for the covariance.
    jacobian_step: float = 1e-3
    #: Dead times [samples] that are tried before the estimation of a dead time.
    instruments_tried: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0)
    #: Number of tried dead times if another model gives an approximate value.
    tried_near: int = 3
    #: Lags that are tried before the estimation of a lag, and step of the difference quotient by the lag [samples].
    tried_lags: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
    lag_step: float = 1e-3
    #: Settling times of the filters in the shortest block of the scores. Tapered blocks separate the filtered noise
    #: from errors that last longer.
    instruments_lasting: int = 4

    # iv
    #: A dead time with a smaller standard error [samples] moves nothing. The whole motion may improve a less certain
    #: one.
    iv_sharp: float = 0.005

    # known
    #: Most iterations. One given force needs a single step; only contradicting facts need more.
    known_most_steps: int = 30
    known_converged: float = 1e-13
    #: No other information tests a fact whose remaining variance is below this part.
    known_untested: float = 1e-9
    #: A fact and a record contradict each other from this number of standard deviations of their difference.
    known_contradicted: float = 3.0
    #: Samples of a record over which the parameters' correlation counts as constant.
    known_piece: int = 200

    # likelihood
    #: Smallest standard deviation of the position's noise [counts]. Below this value the likelihood is a box without
    #: slopes.
    noise_floor: float = 0.02
    #: Relative accuracy of the noise. The likelihood is flat around its top.
    noise_tolerance: float = 1e-3
    #: A noise above this multiple of the floor is either true or a sign of a local maximum.
    given_away: float = 1.5
    #: Distance of starts around a local maximum [standard deviations], and their shrinking noise [counts].
    likelihood_around: float = 1.5
    likelihood_shrinking: tuple[float, float, float] = (0.3, 0.1, 0.04)
    #: Number of starts after the first that must find the same maximum to end the search. The second value is the
    #: largest difference of log-likelihoods at the same maximum. On 56 records with 10 to 300 counts of travel, no
    #: further start found a larger maximum.
    likelihood_agreeing: int = 3
    likelihood_same: float = 0.01
    likelihood_max_iterations: int = 100
    #: Number of downward steps that are accepted for the sake of later ones. If these do not help, the factors tie the
    #: step to small changes of the differences, all computed side by side.
    likelihood_downward: int = 2
    likelihood_ties: tuple[float, ...] = (1e-2, 1e-1, 1e0, 1e1, 1e2, 1e3, 1e4, 1e5)
    #: Longest and shortest step of the difference quotients. A step longer than the remaining way misses the top.
    likelihood_quotient: float = 1e-5
    least_quotient: float = 1e-8
    #: Largest difference [counts] for which a likelihood is evaluated.
    likelihood_lost: float = 1e6
    #: Most steps to the top, and the gain of one step that counts as the top.
    top_steps: int = 30
    top_settled: float = 1e-3
    #: Number of columns from which most entries of a motion in windows are zero and dense equations take long.
    dense_columns: int = 40
    #: An edge has no influence at a greater distance [standard deviations of the noise].
    likelihood_reach: float = 8.0
    #: Noise [counts] from which the edges of the counts no longer matter.
    likelihood_wide: float = 3.0

    # ls
    ls_passes: int = 12
    #: Relative change of every parameter at which the passes end.
    ls_settled: float = 1e-12
    #: Relative change from which the passes count as converged if rounding or noise prevents ls_settled.
    ls_close: float = 1e-6

    # motion
    #: Default number of parts per sample, for forces with a shape and reversals under a lagging input.
    motion_parts: int = 4
    #: Damping that the kernel adds to a body in every step to avoid a division by zero.
    little_damping: float = 1e-9
    #: Most iterations for the speed after a gap. The search ends at a step below the second value, a part of the prior
    #: standard deviation. The motion is linear within such a step.
    motion_turns: int = 30
    motion_small: float = 1e-3
    #: A step without improvement is tried once more, shortened to this part.
    motion_shorter: float = 0.25
    #: Step of the difference quotient by the speed after a gap, as a part of the prior standard deviation.
    velocity_step: float = 0.1
    #: Step of the difference quotients as a part of a parameter. The step is far above the kinks that stops and
    #: reversals leave in the simulated position, and far below the position's curvature.
    quotient_step: float = 1e-4
    max_evaluations: int = 200
    #: Number of motions that vector lanes compute in about the time of one.
    trials_together: int = 8
    #: Most samples of motions that are simulated at once, which bounds the memory.
    samples_together: int = 1_000_000
    #: A step below this part of a standard error ends an iteration.
    settled_step: float = 0.01
    #: Damping of the first step, and the largest damping. A step with more damping moves nothing.
    first_damping: float = 1e-3
    max_damping: float = 1e8
    #: Longest step, in sizes of the parameters at the start. Some of these sizes are only guesses.
    longest_step: float = 1e6
    #: Tolerance for a sum of squares with kinks, at which the last digits never converge. A stop of the model that
    #: comes and goes makes such kinks.
    rough_tolerance: float = 1e-7
    #: Largest root mean square difference [counts] that the encoder explains. Rounding down alone gives 0.29.
    encoder_alone: float = 0.5
    #: Accuracy of the simulated position, as a part of the travel.
    simulation_error: float = 1e-5
    #: Error of the simulated position that shapes may add [counts].
    parts_error: float = 0.005
    #: Counts within a filter time constant by which the start velocity may be off.
    start_counts: float = 3.0
    #: A fit is invalid if a larger part of the motion stays unexplained.
    worst_fit: float = 0.5
    #: Time constants of the longest lag after which an input has no effect left.
    motion_lagging: int = 16
    #: Least mass, as a part of the start's mass. Without mass the motion has no equation.
    least_mass: float = 1e-3
    #: Least value of a parameter that enters the equation nonlinearly, as a part of its start value.
    least_shape: float = 1e-2
    #: Least part of a sensitivity that must be independent of the others.
    motion_apart: float = 1e-3

    # output_error
    #: Parts per sample in the first search of a motion with more parts.
    parts_roughly: int = 2
    #: A mass below this multiple of the smallest allowed mass counts as no mass.
    at_bound: float = 3.0
    #: Largest factor by which the high-pass raises white noise. A larger residual does not explain the counts.
    output_error_hopeless: float = 2.5
    #: Local minima do not explain a difference above this multiple of the encoder's error.
    output_error_far: float = 10.0
    #: Relative tolerance of the rough search.
    output_error_roughly: float = 1e-3
    #: Poles of the high-passes between the first and none, as parts of the first.
    output_error_slower: tuple[float, ...] = (1 / 4, 1 / 16, 1 / 64, 0.0)

    # plants
    #: Part of a column's power that products of columns show accurately. The rounding error is 1e-16 over its square.
    products_accurate: float = 1e-5
    #: Relative pivot of the information matrix from which a first estimate exists.
    start_pivot: float = 1e-4
    #: Least number of time constants of the slowest pre-filter zero in a memory.
    zero_memories: int = 2
    #: Least ratio of the two zeros. With a ratio of three, a short memory had weak instruments.
    plants_apart: float = 5.0
    #: Candidates for the faster zero, as parts of the cutoff. The slower zero is a thirtieth of the faster one.
    plants_fractions: tuple[float, ...] = (1 / 5, 1 / 10, 1 / 20, 1 / 40, 1 / 80)
    plants_ratio: float = 30.0
    #: Candidates for the fastest zero of a linear process, and ratios of the fastest to the slowest zero. The zeros are
    #: evenly spaced on a logarithmic scale.
    process_fractions: tuple[float, ...] = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
    process_ratios: tuple[float, float, float] = (3.0, 10.0, 30.0)
    #: Example motion of a machine: counts per sample at full speed, and the parts of the input that the frictions take.
    counts_per_sample: float = 40.0
    viscous_part: float = 0.6
    coulomb_part: float = 0.3
    #: Example motion with edges: counts per sample at full speed, time constant [samples], and instants in a sample.
    edges_per_sample: float = 3.0
    edges_slow: float = 10.0
    edges_instants: int = 20
    #: Counts of the example linear process for an input of one.
    process_counts: float = 500.0

    # recursive
    #: Samples of a response in memory at once.
    recursive_part: int = 2**17
    #: Least encoder error in the leading column.
    recursive_least: float = 1e-18
    #: Number of frequencies for the gain of an encoder's error, and their decades below the sampling frequency.
    recursive_frequencies: int = 4096
    recursive_decades: int = 9
    #: Information that is never forgotten under constant trace, as a part of the largest seen.
    trace_regularization: float = 1e-6
    #: Factor by which the recursion forgets information from larger earlier motions faster.
    recursive_haste: int = 8
    #: Information above this multiple of the last memory's information counts as that of larger motions.
    recursive_outgrown: int = 3
    #: The sliding window drops one of its 8 blocks at a time: it holds 7 to 8 of them.
    window_blocks: float = 7.5

    # runner
    #: The number of axes that a thread takes at once is a multiple of this number, the size of the kernel's largest
    #: vector.
    runner_group: int = 16
    #: Pieces of work for each thread. Smaller pieces shorten the wait for the last thread.
    runner_pieces: int = 4
    #: Less work than this [axes times samples] is not worth a second thread.
    runner_small: int = 20_000

    # search
    #: Time constants of the filters in which the start of a free run is read.
    search_read: float = 5.0
    #: Most Gauss-Newton passes. A stop that comes and goes may prevent convergence.
    search_passes: int = 8
    settled_start: float = 1e-12
    #: A step that is too long is tried once more, shortened to this part.
    search_shorter: float = 0.25
    #: Start values of the Stribeck speed, as parts of the usual speed. The remaining sum of squares differs between
    #: them.
    stribeck_speeds: tuple[float, float, float] = (0.03, 0.1, 0.3)
    #: Number of start speeds that the search keeps, because the best start need not lead to the best maximum.
    most_speeds: int = 2
    #: Number of windows over each sample. Two overlapping windows make the result independent of the windows' places.
    search_hops: int = 2
    max_steps: int = 60
    #: Number of steps that measure the pace of a descent. Some of these steps may only raise the damping.
    steps_watched: int = 6
    #: A step that lowers the sum of squares by a smaller part ends the descent.
    settled_descent: float = 1e-8
    #: Tolerance of a descent for the comparison of windows of different lengths.
    search_roughly: float = 1e-4
    #: Parts of the record, each predicted from the others by a free run.
    search_folds: int = 3
    #: Numbers of pieces in which a part is also run, each piece with its own start. One long run depends on chance, and
    #: many short ones say little about drift. The second value is the least ratio of a piece to the span for its start.
    search_pieces: tuple[int, ...] = (1, 2, 4, 8)
    search_worth: int = 4
    #: Shortest window, in time constants of the filters and in samples. A shorter window shows little but its start.
    search_shortest: float = 20.0
    search_fewest: int = 40
    #: A motion from a single start is lost if it leaves this part of the motion. Windows in these numbers are then
    #: tried, as far as the record has samples. Fewer windows are taken if the sum of squares grows by at most the last
    #: number of standard deviations.
    restarts_lost: float = 0.3
    restarts_tried: tuple[int, ...] = (32, 64, 128)
    restarts_worse: float = 4.0
    #: A longer window is preferred if its prediction error is larger by at most this part, because it contains more
    #: information.
    as_well: float = 0.05

    # sharded_fleet
    #: Places of a shard. A disk writes these megabytes at once, and a single changed axis makes little to write again.
    sharded_fleet_shard: int = 4096
    #: Axes that a thread steps at once.
    sharded_fleet_piece: int = 512

    # srivc
    #: Largest relative difference of two sample periods that count as equal.
    same_period: float = 0.05
    #: Least part of a sensitivity that must be independent of the others.
    srivc_apart: float = 1e-6
    #: Fastest pole that samples can show, as a multiple of 1 / dt.
    srivc_fastest: float = 2.0

    # stretches
    #: Samples of the longest record that is used as a whole in each step. A longer record is represented by its
    #: liveliest stretch of this length where any part of it gives the same answer.
    stretch: int = 20_000
    #: Turns of the iteration on a long record from the estimate of a stretch.
    stretch_turns: int = 12
    #: Greatest number of parts of a sample for Stribeck friction along a long record.
    stretch_parts: int = 4

    # uncertainty
    #: Least number of blocks of the greatest length.
    uncertainty_fewest: int = 24
    #: Width of the coarse difference quotients that check the fine ones, as a part of a parameter.
    uncertainty_coarse: float = 1e-2
    #: A larger factor between two variances shows that the dependence is not smooth.
    uncertainty_smooth: float = 4.0
    #: Further widths for a rough dependence.
    uncertainty_widths: tuple[float, ...] = (1e-3, 3e-2, 0.1, 0.3)
    #: Number of tried places of the lattice.
    uncertainty_phases: int = 32
    #: Number of places of the lattice at which the likelihood's top is searched.
    uncertainty_tops: int = 16

    # edges
    #: Largest relative excess of an age over the step of the clock.
    edges_late: float = 1e-6
    #: Relative accuracy to which times and forces are known. Crystals are made to 20 ppm.
    edges_exact: float = 1e-5
    #: On-line each line has 8 sums; this many lines are 4 MB.
    most_lines: int = 65536


TUNING = EstimatorTuning()
