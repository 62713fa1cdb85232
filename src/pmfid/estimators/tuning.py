"""Thresholds, limits and counts of `pmfid.estimators`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class EstimatorTuning:
    """One value for each decision of `pmfid.estimators`, by module."""

    # adequacy
    #: Coulomb friction of a machine is taken for at least this part of the motor's force.
    least_friction: float = 0.02
    #: Stribeck friction is averaged over parts of a sample, because it turns within a fraction of a sample at a
    #: reversal. Greatest change of velocity within a part, as a fraction of the Stribeck speed, and greatest number of
    #: parts.
    adequacy_fine: float = 0.1
    most_parts: int = 16
    #: A smaller change of velocity, as a part of the Stribeck speed, is none.
    adequacy_steady: float = 1e-3
    #: What a machine may well have: parts of Coulomb friction, of viscous friction, of the motor's force, of a sample,
    #: of the largest input.
    adequacy_stribeck: float = 0.3
    adequacy_uneven: float = 0.15
    adequacy_curved: float = 0.15
    late_by: float = 0.5
    dead_zone: float = 0.03
    #: Parts of the largest input from which on an amplifier may give less.
    adequacy_kinks: tuple[float, float, float] = (0.5, 0.7, 0.9)
    #: A force is missed if its score exceeds this number of standard deviations: by chance once in a thousand records.
    adequacy_missed: float = 4.0
    #: Forces that explain at least this part of what the best explains are named, too; greatest number of named forces.
    adequacy_nearly: float = 0.8
    most_said: int = 3
    #: Parts of a record that a force is to explain with what the others say of it.
    adequacy_parts: int = 6
    #: Part of the information on a force below which a part of the record says nothing of it.
    adequacy_rare: float = 1e-6
    #: Two estimates contradict each other from this number of standard deviations of their difference on.
    adequacy_contradicted: float = 2.5
    #: Part of a force's effect that is no combination of the parameters', below which nothing can be said of it.
    adequacy_apart: float = 1e-4
    #: A force moves the simulation by this part of what is plausible, or of the motor's force, for its derivative.
    adequacy_step: float = 0.1
    step_of_force: float = 1e-3

    # auxiliary
    #: Time constant of the slow copy of the estimate that drives the model, in filter time constants: the instruments
    #: must not follow the noise of the samples that they are multiplied with.
    copy_time_constants: float = 17.0
    #: Mean square difference of model and measured velocity, as a part of the mean square, beyond which it is not
    #: trusted.
    mismatch_limit: float = 0.2
    #: With shapes; with 3 the first samples still showed after 4000, with 7 the error bars were longer.
    growing_with_shapes: int = 5
    #: Memory of that comparison, in filter time constants.
    check_time_constants: float = 30.0
    #: Memory of the comparison that shows a model ahead of the plant, and the span of samples that it takes for one;
    #: both in filter time constants.
    lag_time_constants: float = 1000.0
    alike_time_constants: float = 2.0
    #: Mean square innovation, over what a white encoder error explains, beyond which the equation is called wrong
    #: on-line, and the stretches of samples that it is taken over, two at a time, in filter time constants.
    auxiliary_unexplained: float = 2.5
    model_check_time_constants: float = 50.0

    # base
    max_settle_samples: int = 10**8
    #: Sample periods that anything has [s].
    base_shortest: float = 1e-12
    base_longest: float = 1e12
    #: In place of a smaller cutoff * dt, which is refused: numbers beyond float64 would come of it.
    least_product: float = 1e-300
    #: Updates from the accumulated right-hand side; later ones move theta by the innovation alone. float64 without
    #: forgetting never changes over.
    residual_updates: int = 256
    #: Settling times of the filters over which motion limits are learned before they hold strictly, and over which they
    #: are forgotten. Only samples in motion count.
    base_learning: int = 8
    base_learned: int = 128
    #: Samples from a suspicious one on that are left out: then the filters have forgotten most of what stands in its
    #: place.
    held_out: int = 8

    # batch
    #: A target closer than this to one regressor alone, relative to its size, identifies nothing else.
    target_apart: float = 1e-6
    tiny: float = 1e-300
    #: The square of a number must not leave the format.
    batch_beyond: float = 1e120

    # bridges
    #: Span in which the speed after a gap is read: filter time constants, or time constants of the body's damping.
    bridges_read: float = 3.0
    #: Samples of the shortest part of a record; a part also lasts a filter time constant.
    bridges_fewest: int = 8
    #: Turns in which that speed, and the input that leads to it, are found.
    bridges_turns: int = 20
    bridges_close: float = 1e-9
    #: Damping times the time of reading below which nothing is forgotten.
    bridges_little: float = 1e-6

    # cutoff
    #: Time constants of the filters that are tried [samples]: by more the encoder's error is averaged, by less what the
    #: motion says of the mass is kept. The first with an estimate gives the motion that all are judged along.
    cutoff_tried: tuple[int, ...] = (10, 30, 3, 100, 300)
    #: Filter time constants of the shortest record.
    cutoff_least: int = 30
    #: Filter time constants of the shortest memory on-line, and samples of the longest filter time constant. With
    #: slower filters the recursion forgets its information before it may trust its instruments, and falls back for most
    #: of the time, on axes from 3e-5 kg m2 to 500 kg; 30 samples were the best of all on most of these axes.
    cutoff_remembered: int = 3
    cutoff_slowest: int = 30

    # friction_curve
    #: Parts of a sample over which a hat is taken.
    friction_curve_parts: int = 4
    #: The measured velocity corrects the simulated one below this part of the cutoff.
    friction_curve_slow: float = 0.3
    #: A direction with less of the samples is none.
    least_part: float = 0.02
    #: The first node is at this quantile of the speed; they are no closer to each other, and to the last, than these
    #: parts.
    friction_curve_slowest: float = 0.02
    friction_curve_closest: float = 0.01
    friction_curve_apart: float = 0.05
    #: Knots of the table that the kernel simulates.
    friction_curve_knots: int = 128
    #: Nodes of each direction in addition to the one at rest.
    friction_curve_nodes: int = 10
    #: Turns in which the curve goes back into the simulation.
    friction_curve_turns: int = 3
    #: Blocks of the record, and the turns in which they are left out.
    friction_curve_blocks: int = 32
    friction_curve_folds: int = 8
    #: Part of the smoothing in the curve of the error bars: the whole smoothing may hide what the record can hardly
    #: show.
    friction_curve_less: float = 0.01

    # instruments
    instruments_max_iterations: int = 40
    instruments_tolerance: float = 1e-7
    #: A stop of the model that comes and goes with theta keeps the iteration in a small cycle: from here on half steps,
    damped_from: int = 15
    #: and a cycle of this relative size is an answer.
    instruments_accepted: float = 2e-3
    #: A parameter whose term is less than this part of the target may be zero: its change is measured against that.
    instruments_small: float = 1e-2
    #: The first part of a record, in which the model's velocity forgets that its start was not known.
    start_part: float = 0.05
    #: Samples with equal counts at the start of a record that may begin at rest.
    rest_samples: int = 5
    #: Relative step of the differences for the covariance.
    jacobian_step: float = 1e-3
    #: Dead times [samples] that are tried before one is estimated.
    instruments_tried: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0)
    #: How many of them, where another model says about which.
    tried_near: int = 3
    #: Lags, likewise; and the step of the difference quotient by the lag, both in samples.
    tried_lags: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
    lag_step: float = 1e-3
    #: Settling times of the filters in the shortest block of the scores. Blocks that fade in and out separate the
    #: filtered noise from errors that last longer.
    instruments_lasting: int = 4

    # iv
    #: A dead time known to this [samples] moves nothing; one that is known worse may be known better from the whole
    #: motion.
    iv_sharp: float = 0.005

    # known
    #: Steps. One step is enough for one given force; only facts that contradict each other take more.
    known_most_steps: int = 30
    known_converged: float = 1e-13
    #: A fact that the others leave this part of its variance is tested by nothing.
    known_untested: float = 1e-9
    #: Standard deviations of the difference between a fact and a record from which on they contradict each other.
    known_contradicted: float = 3.0
    #: Samples of a record over which the correlation of the parameters is taken for the same.
    known_piece: int = 200

    # likelihood
    #: Least standard deviation of the position's own noise, in counts: below, the likelihood is a box without slopes.
    noise_floor: float = 0.02
    #: Relative accuracy of the noise: the likelihood is flat around its top.
    noise_tolerance: float = 1e-3
    #: A noise beyond the floor by this factor is true, or a sign of a local maximum.
    given_away: float = 1.5
    #: The search leaves a local maximum by starts around it: distance [standard deviations], noise [counts].
    likelihood_around: float = 1.5
    likelihood_shrinking: tuple[float, float, float] = (0.3, 0.1, 0.04)
    #: Starts after the first that must find the same maximum to end the search, and difference of the logarithms of two
    #: likelihoods of the same maximum. On 56 records with 10 to 300 counts of travel no further start found a larger
    #: one.
    likelihood_agreeing: int = 3
    likelihood_same: float = 0.01
    likelihood_max_iterations: int = 100
    #: Steps downward that are taken for the sake of later ones. Where none helps, a cost of the change of the
    #: differences shortens the step: by these factors, side by side.
    likelihood_downward: int = 2
    likelihood_ties: tuple[float, ...] = (1e-2, 1e-1, 1e0, 1e1, 1e2, 1e3, 1e4, 1e5)
    #: Longest and shortest step of the difference quotients: a longer one than what is left of the way misses the top.
    likelihood_quotient: float = 1e-5
    least_quotient: float = 1e-8
    #: Largest difference, in counts, that a likelihood is asked for.
    likelihood_lost: float = 1e6
    #: Steps to that top, and what one gains at the top.
    top_steps: int = 30
    top_settled: float = 1e-3
    #: Columns from which on those of a motion in windows are mostly zeros, and equations of steps take long.
    dense_columns: int = 40
    #: Distance from an edge beyond which the edge has no influence [standard deviations of the noise].
    likelihood_reach: float = 8.0
    #: Noise, in counts, from which on the edges of the counts no longer show.
    likelihood_wide: float = 3.0

    # ls
    ls_passes: int = 12
    #: Relative change of every parameter at which the passes end.
    ls_settled: float = 1e-12
    #: ... and from which on they are taken to have settled where rounding or noise goes on.
    ls_close: float = 1e-6

    # motion
    #: Parts of a sample in the simulation of forces with a shape and of reversals under a lagging input: by default,
    #: and at most.
    motion_parts: int = 4
    #: Damping that the kernel gives a body in every step, so that it may divide by it.
    little_damping: float = 1e-9
    #: Turns of the search for the speed after a gap, and the part of its prior standard deviation at which a step ends
    #: the search: the motion is linear within that.
    motion_turns: int = 30
    motion_small: float = 1e-3
    #: A step that leads to no better motion is tried once more as this part of itself.
    motion_shorter: float = 0.25
    #: Step of the difference quotient by that speed, as a part of the same.
    velocity_step: float = 0.1
    #: Step of the difference quotients as a part of a parameter: far above the kinks that stops and reversals leave in
    #: the simulated position, far below what makes the position bend.
    quotient_step: float = 1e-4
    max_evaluations: int = 200
    #: Motions that vector lanes compute at about the price of one.
    trials_together: int = 8
    #: A step by less than this part of a standard error ends an iteration.
    settled_step: float = 0.01
    #: Damping of the first step, and the largest one: a step that is damped more moves nothing.
    first_damping: float = 1e-3
    max_damping: float = 1e8
    #: Longest step, in sizes of the parameters at the start. Some of these sizes are only guessed.
    longest_step: float = 1e6
    #: A stop of the model that comes and goes puts kinks into the sum of squares, at which the last digits never
    #: settle.
    rough_tolerance: float = 1e-7
    #: Root mean square of the difference, in counts, up to which the encoder explains it; rounding down alone gives
    #: 0.29.
    encoder_alone: float = 0.5
    #: Accuracy of the simulated position, as a part of the travel.
    simulation_error: float = 1e-5
    #: Error of the simulated position that shapes may add [counts].
    parts_error: float = 0.005
    #: Counts within a filter time constant by which the start velocity may be off.
    start_counts: float = 3.0
    #: A larger part of the motion left unexplained is no fit.
    worst_fit: float = 0.5
    #: Time constants of the longest lag after which an input has no effect left.
    motion_lagging: int = 16
    #: Least mass, as a part of the start's mass: without any the motion has no equation.
    least_mass: float = 1e-3
    #: The same of a parameter that the equation is not linear in.
    least_shape: float = 1e-2
    #: Part of a sensitivity that must not follow from the others.
    motion_apart: float = 1e-3

    # output_error
    #: Parts of a sample in which a motion of more parts is followed first.
    parts_roughly: int = 2
    #: Multiple of the smallest allowed mass, below which the fit would rather have no mass.
    at_bound: float = 3.0
    #: Factor by which the high-pass at most raises white noise: a larger residual after it does not explain the counts.
    output_error_hopeless: float = 2.5
    #: Multiple of the encoder's error beyond which a difference is no matter of local minima.
    output_error_far: float = 10.0
    #: Relative tolerance of that.
    output_error_roughly: float = 1e-3
    #: High-passes on the way to none, as parts of the first.
    output_error_slower: tuple[float, ...] = (1 / 4, 1 / 16, 1 / 64, 0.0)

    # plants
    #: Part of a column's power that products of columns show to many digits: their rounding is 1e-16 over its square.
    products_accurate: float = 1e-5
    #: Relative pivot of the information matrix from which on a first estimate is given.
    start_pivot: float = 1e-4
    #: Time constants of the slowest pre-filter zero in a memory, at least.
    zero_memories: int = 2
    #: Ratio of the two zeros, at least: with three the instruments of a short memory were weak.
    plants_apart: float = 5.0
    #: Candidates for the faster zero as a part of the cutoff; the slower one is a thirtieth of it.
    plants_fractions: tuple[float, ...] = (1 / 5, 1 / 10, 1 / 20, 1 / 40, 1 / 80)
    plants_ratio: float = 30.0
    #: The same for a linear process, whose zeros lie evenly in the logarithm: fastest zero, and that over the slowest.
    process_fractions: tuple[float, ...] = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
    process_ratios: tuple[float, float, float] = (3.0, 10.0, 30.0)
    #: Of the made-up motion: counts per sample at full speed, and the parts of the input that the frictions take.
    counts_per_sample: float = 40.0
    viscous_part: float = 0.6
    coulomb_part: float = 0.3
    #: And of the made-up linear process, for an input of one.
    process_counts: float = 500.0

    # recursive
    #: Samples of a response that are in memory at once.
    recursive_part: int = 2**17
    #: What the encoder shows of the leading column, at least.
    recursive_least: float = 1e-18
    #: Frequencies of the gain of an encoder's error, and their decades below the sampling frequency.
    recursive_frequencies: int = 4096
    recursive_decades: int = 9
    #: Information that is never forgotten under constant trace, as a part of the largest seen.
    trace_regularization: float = 1e-6
    #: Factor by which information from larger motions than the recent ones is forgotten faster.
    recursive_haste: int = 8
    #: Multiple of the information of the last memory's motions, above which information is attributed to larger
    #: motions.
    recursive_outgrown: int = 3
    #: The sliding window drops one of its 8 blocks at a time: it holds 7 to 8 of them.
    window_blocks: float = 7.5

    # runner
    #: Axes that a thread takes at a time are a multiple of this: no vector of the kernel holds more.
    runner_group: int = 16
    #: Pieces of work for each thread, so that none waits long for the last one.
    runner_pieces: int = 4
    #: Less work than this [axes times samples] is not worth a second thread.
    runner_small: int = 20_000

    # search
    #: Time constants of the filters over which the start of a free run is read.
    search_read: float = 5.0
    #: Passes of Gauss and Newton's method; a stop that comes and goes may keep it from settling.
    search_passes: int = 8
    settled_start: float = 1e-12
    #: A step too far is tried once more as this part of itself.
    search_shorter: float = 0.25
    #: Stribeck speeds to start from, as parts of the usual one: with each, what is left is a sum of squares of its own.
    stribeck_speeds: tuple[float, float, float] = (0.03, 0.1, 0.3)
    #: Those that are gone on from: the one that leaves the least need not lead to the best maximum.
    most_speeds: int = 2
    #: Each window begins in the middle of the one before: where they lie must not decide.
    search_hops: int = 2
    max_steps: int = 60
    #: Steps whose pace says whether a descent comes down to where it must: of these some may only raise the damping.
    steps_watched: int = 6
    #: A step that lowers the sum of squares by less than this part has settled.
    settled_descent: float = 1e-8
    #: The same where windows of different lengths are compared.
    search_roughly: float = 1e-4
    #: Parts of the record, each predicted from the others by a free run.
    search_folds: int = 3
    #: Pieces in which a part is run as well, each with its own start: one long run is a matter of chance, many short
    #: ones say little on drift. search_worth: length of a piece over the span that its start is read from.
    search_pieces: tuple[int, ...] = (1, 2, 4, 8)
    search_worth: int = 4
    #: The shortest window, in time constants of the filters and in samples: shorter ones say little but where they
    #: start.
    search_shortest: float = 20.0
    search_fewest: int = 40
    #: Part of the motion that is left where a motion from a single start is lost. Numbers of windows that are tried
    #: there, as far as the record has samples for them; and fewer of them, as long as the sum of squares grows by no
    #: more standard deviations than these.
    restarts_lost: float = 0.3
    restarts_tried: tuple[int, ...] = (32, 64, 128)
    restarts_worse: float = 4.0
    #: A longer window is taken where it predicts as well but for this part: it knows more.
    as_well: float = 0.05

    # sharded_fleet
    #: Places of a shard: some MB, which a disk writes in one go, and little to write again for a single axis.
    sharded_fleet_shard: int = 4096
    #: Axes that a thread steps at once.
    sharded_fleet_piece: int = 512

    # srivc
    #: Relative difference of two sample periods that are taken for one.
    same_period: float = 0.05
    #: Part of a sensitivity that must not follow from the others.
    srivc_apart: float = 1e-6
    #: The fastest pole that samples can tell: 2 / dt.
    srivc_fastest: float = 2.0

    # uncertainty
    #: Blocks of the longest scale, at least.
    uncertainty_fewest: int = 24
    #: Width of the difference quotients that are compared with the fine ones, as a part of a parameter.
    uncertainty_coarse: float = 1e-2
    #: Factor between variances beyond which the dependence is not smooth.
    uncertainty_smooth: float = 4.0
    #: Further widths for a rough dependence.
    uncertainty_widths: tuple[float, ...] = (1e-3, 3e-2, 0.1, 0.3)
    #: Places of the lattice that are tried: their mean square is exact for the harmonics that hold nine tenths of it.
    uncertainty_places: int = 8
    #: A simulated motion that goes further runs away [counts].
    most_counts: float = 2.0**53
    #: Places of the lattice that are tried.
    uncertainty_phases: int = 32
    #: Places of the lattice at which the top of the likelihood is looked for.
    uncertainty_tops: int = 16

    # edges
    #: An age may exceed the step of the clock by this part.
    edges_late: float = 1e-6
    #: Poles of the high-passes that the search passes, in parts of the cutoff; 0: none.
    edges_slower: tuple[float, ...] = (1.0, 0.1, 0.0)
    #: Fewest edges for each unknown.
    edges_fewest: int = 5
    #: Turns of variances and least squares. The variances settle to a few percent within three.
    edges_passes: int = 3
    #: Smallest standard deviation of an edge [counts]: the simulation is no better.
    edges_finest: float = 1e-6
    #: The simulation is right to this part of each parameter.
    edges_exact: float = 1e-6
    #: An edge that is further from each line is of no line [counts].
    edges_between: float = 0.35
    #: An edge this many standard deviations of its instant before or after a sample may be of another one.
    edges_truncated: float = 4.0
    #: Parts of the edges that no motion explains, and of edges of another line than that of their count: more is a
    #: wrong model, and far more no estimate.
    edges_few: float = 0.02
    edges_moved: float = 0.1
    edges_most_dropped: float = 0.25
    #: Lines are cut more evenly than this [counts, root mean square]: the rest is a wrong model.
    edges_rough: float = 0.15
    #: A smaller spread of the lines is not reported [counts].
    edges_reported: float = 0.002
    #: Lines that come this often have places of their own in the first least squares.
    edges_repeated: float = 5.0
    #: Variance of sums of errors over blocks, over that of errors without correlation. Chance makes less than 3.
    edges_correlated: float = 4.0


TUNING = EstimatorTuning()
