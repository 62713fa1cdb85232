"""Thresholds, limits and counts of `pmfid.actuators`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class ActuatorTuning:
    """One value for each decision of `pmfid.actuators`, by module."""

    # logs
    #: Magnitude beyond which a double shows no step of an encoder, in any unit. Such a number is damaged.
    largest_number: float = 2.0**53
    #: Standard acceleration of free fall [m/s2], for a file that states a mass and a length.
    free_fall: float = 9.80665
    #: Stamps of SAGE beyond this are in microseconds [s].
    longest_log: float = 1e4
    #: The encoder's step is read from distances of neighbouring positions up to these multiples of it in turn, because
    #: text is rounded. That many distances are needed.
    step_multiples: tuple[int, ...] = (1, 4, 16)
    step_levels: int = 20
    #: Part of a step by which a distance may differ from a whole number, and the part of all distances that do not.
    step_tolerance: float = 0.1
    step_share: float = 0.95
    # problem
    #: The start position and the start velocity follow the parameters in the coordinates.
    nuisance: int = 2
    # fit
    #: Rounds of a search: the number of random starts, and the number of the best ones that are refined. The last
    #: round comes only if the deviation of the one before exceeds `explained` steps of the encoder (rms).
    rounds: tuple[tuple[int, int], ...] = ((80, 3), (600, 8))
    explained: float = 0.35
    #: Periods of the loop between two ticks while random starts are compared.
    quick_ticks: float = 4.0
    #: Two minima are the same one if their squared residuals differ by less than this factor.
    same_minimum: float = 1.01
    #: Steps of each of these refinements, and number of the best ones that are refined to the end.
    first_evaluations: int = 10
    finished: int = 2
    #: Starts are compared on this much of the motion [s].
    start_time: float = 12.0
    #: Terms are searched in this part of the motion first, if it is shorter than this part of the log.
    short_head: float = 0.5
    #: Ranges from which starts are drawn: natural frequency [rad/s], damping ratio, delay [sample periods], Coulomb
    #: friction over the torque that the error of the position commands.
    frequencies: tuple[float, float] = (5.0, 300.0)
    dampings: tuple[float, float] = (0.05, 3.0)
    delays: float = 3.5
    frictions: tuple[float, float] = (0.003, 0.5)
    #: Steps of one refinement: their number, and their first and largest damping. A step that gains less than the
    #: least part of the squared residual is the last one. No step changes the logarithm of a parameter by more than the
    #: longest step.
    evaluations: int = 60
    damping: float = 1e-4
    most_damping: float = 1e2
    least_gain: float = 1e-6
    longest_step: float = 3.0
    #: The fit needs this many samples for each parameter.
    samples_each: int = 10
    #: Steps of the search for the largest likelihood, its ridge, and the last gain.
    newton_steps: int = 15
    newton_ridge: float = 1e-2
    newton_gain: float = 1e-2
    #: Least information on a direction of the coordinates, as a part of the largest one. Rounding errors hide less.
    least_information: float = 1e-10
    #: The loop sees counts if its log is likelier by this [natural units].
    counted_gain: float = 10.0
    #: Changes of the start [encoder steps] that are compared in a loop on counts, whose derivatives do not show them.
    places: tuple[float, ...] = (0.0, -0.3, -0.15, 0.15, 0.3)
    #: Least scatter [encoder steps] of the position before rounding. It stands for what any model neglects.
    least_scatter: float = 0.08
    #: Number of bins of the histogram of deviations in the search for the scatter.
    bins: int = 256
    #: Largest deviation in the likelihood [encoder steps].
    widest: float = 1e4
    #: Phases of the start within one encoder step at which the effect of rounding in the loop is computed.
    phases: int = 6
    #: Phase of the loop's ticks after a sample [ticks], whose effect is one standard error.
    late_ticks: float = 0.5
    #: Part of the doubt in the loop's delay and in its ticks that is left if the loop is known.
    known_loop: float = 0.2
    #: Part of the viscous friction that may be a gain kd of the loop.
    loop_share: float = 0.5
    #: Limit of a torque that is never reached [N m].
    no_limit: float = 1e12
    #: A coordinate with derivatives below this [steps] has no effect. It is lifted to this part of a clear value.
    no_effect: float = 1e-3
    lift: float = 1e-3
    #: Blocks of the record whose scores give the standard errors, and the shortest block [s].
    blocks: int = 40
    shortest_block: float = 0.25
    # rivals
    #: Parts of a load-dependent friction at which servos are fitted as well, 1 for a step up. The step is the friction
    #: itself, or the least step. No friction takes more of the load than the last value.
    rival_parts: tuple[float, ...] = (0.25, 0.5, 1.0)
    rival_step: float = 0.1
    most_load: float = 0.9
    #: Stribeck friction over Coulomb friction, and its speed over the typical speed, of servos that have this friction.
    #: The second one stands for all frictions that bend slowly.
    #: A negative one is a friction that rises, such as that of a gear.
    rival_stribecks: tuple[tuple[float, float], ...] = ((0.5, 0.2), (0.3, 2.0), (-0.3, 1.0))
    #: A load-dependent friction belongs to a servo that it makes likelier by this [natural units of independent
    #: samples]. Servos without it became less likely in each of 53 logs.
    rival_gain: float = 6.0
    # waves
    #: Waves a turn of a torque that gravity hides, and of one that no gravity hides.
    waves: tuple[float, float] = (3.0, 12.0)
    #: A torque of the position belongs to a servo that it makes likelier by this [natural units], if it gains this
    #: many times as much as the fast wave, and moves an estimate by this many standard errors. Seven servos with
    #: cogging next to a known gravity and an empty status had more of each; none of 53 right servos had.
    wave_gain: float = 9.0
    wave_ratio: float = 2.0
    wave_moves: float = 3.0
    # terms
    #: A term is added if it explains this part of the squared residual, beyond this many standard deviations.
    explains: float = 0.03
    beyond: float = 6.0
    #: A term that explains this part is added however correlated the residual is.
    plain: float = 0.3
    most_added: int = 3
    #: An added term stays if its value is more than this many standard errors.
    clear: float = 3.0
    #: If rounding explains the residual, a term is fitted only if it explains this share of that part to first order.
    first_order: float = 0.5
    #: Number of terms that are refined to find the best one, if the residual contradicts the model.
    tried: int = 3
    # findings
    #: The residual contradicts the model from this multiple of the encoder's rounding on.
    contradicted: float = 1.5
    #: A residual persists if it is correlated this much from one sample to the next. The model is then doubted from
    #: this multiple of the least scatter on. Right models leave the least scatter, wrong frictions two to four times
    #: as much.
    correlated: float = 0.3
    doubted: float = 1.7
    #: The residual contradicts the model from this multiple of the rounding on, also if it is not correlated.
    noisy: float = 3.0
    #: Smallest scatter of the steps of stamps relative to their mean, and smallest jump of a commanded step relative to
    #: the range of the goals.
    stamped: float = 1e-3
    goal_step: float = 0.1
    #: A parameter is open from this relative standard error on.
    open_from: float = 0.5
    #: The torque is limited during so much of the record that a limit belongs to the model.
    limited: float = 0.2

    # checks
    #: Samples that a check of a log needs, and the longest lag of a position after its goal, or before it [s].
    least_checked: int = 50
    longest_lag: float = 0.5
    #: A position follows a goal from this correlation on. It follows the goal of another joint if that correlation is
    #: high, and better by this much.
    follows: float = 0.4
    exchanged: float = 0.8
    better: float = 0.2
    #: Goal and position have different units if their ratio is that of the units up to this factor.
    unit_within: float = 3.0
    #: A position that is best explained by a goal of this many samples later moves before its goal.
    early: float = 0.5
    # exports
    #: Step of the exported model of MuJoCo [s].
    mujoco_step: float = 1e-3
    #: Gravity is that of a mass within this distance of the axis [m]. A joint without gravity has the least mass [kg].
    longest_arm: float = 0.1
    least_mass: float = 1e-6
    #: Inertia of a body without its armature, as a part of the joint's inertia. MuJoCo refuses a body of none.
    least_inertia: float = 1e-3


TUNING = ActuatorTuning()
