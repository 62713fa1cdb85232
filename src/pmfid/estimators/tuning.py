"""Thresholds, limits and counts of `pmfid.estimators`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class EstimatorTuning:
    """Thresholds, limits and counts of `pmfid.estimators`, by module."""

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
    #: Number of first updates in which a solution corrects the rounding of the last one. Later the innovations alone
    #: move theta. float64 without forgetting never changes over.
    residual_updates: int = 256

    # batch
    #: A target that is closer to one regressor alone, or a sensitivity that is closer to the others, relative to its
    #: size, identifies no other parameter.
    target_apart: float = 1e-6
    #: Largest number whose square stays within the format.
    beyond: float = 1e120

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

    # known
    known_converged: float = 1e-13
    #: No other information tests a fact whose remaining variance is below this part.
    known_untested: float = 1e-9
    #: A fact and a record, or a method and the fit, contradict each other from this number of standard deviations of
    #: their difference. A smaller error is noise.
    contradicted: float = 3.0
    #: Samples of a record over which the parameters' correlation counts as constant.
    known_piece: int = 200

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
    #: Largest forgetting factor in float32, whose sums stop growing at 2^24 samples.
    float32_forgetting: float = 0.999999
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
    #: Factor by which the recursion forgets information from larger earlier motions faster.
    recursive_haste: int = 8
    #: Information above this multiple of the last memory's information counts as that of larger motions.
    recursive_outgrown: int = 3

    # fleet
    #: The number of axes that a thread takes at once is a multiple of this number, the size of the kernel's largest
    #: vector.
    fleet_group: int = 16
    #: Pieces of work for each thread. Smaller pieces shorten the wait for the last thread.
    fleet_pieces: int = 4
    #: Less work than this [axes times samples] is not worth a second thread.
    fleet_small: int = 20_000

    # srivc
    #: Largest relative difference of two sample periods that count as equal.
    same_period: float = 0.05

    # stretches
    #: Samples of the longest record that is used as a whole in each step. A longer record is represented by its
    #: liveliest stretch of this length where any part of it gives the same answer. The same number of samples chooses
    #: the pole of the first filters of srivc.
    stretch: int = 20_000

    # edges
    #: Largest relative excess of an age over the step of the clock.
    edges_late: float = 1e-6
    #: Relative accuracy to which times and forces are known. Crystals are made to 20 ppm.
    edges_exact: float = 1e-5
    #: On-line each line has 8 sums; this many lines are 4 MB.
    most_lines: int = 65536


TUNING = EstimatorTuning()
