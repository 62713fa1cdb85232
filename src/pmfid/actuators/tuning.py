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
    #: Steps in a turn of a register, in the usual servos of Dynamixel and Feetech.
    register: int = 4096
    #: The encoder's step is read from distances of neighbouring positions up to these multiples of it in turn, because
    #: text is rounded. That many distances are needed.
    step_multiples: tuple[int, ...] = (1, 4, 16)
    step_levels: int = 20
    #: Part of a step by which a distance may differ from a whole number, and the part of all distances that do not.
    step_tolerance: float = 0.1
    step_share: float = 0.95
    # body
    #: Torque limit of a servo without one [N m], and steps of a known torque between two rows.
    no_limit: float = 1e12
    pieces: int = 4
    # search
    #: Motions that a problem remembers.
    remembered: int = 8
    #: Starts and terms are compared on this much of the motion of a log [s], and on this number of logs.
    head: float = 12.0
    most_heads: int = 4
    #: Random servos that are simulated for the first seconds, those that are simulated for the head, and the best ones
    #: that are refined.
    draws: int = 200
    sprint: float = 3.0
    selected: int = 40
    refined: int = 4
    #: Ranges of random servos: natural frequency [rad/s], damping ratio, Coulomb friction over the torque of the lag,
    #: delay [sample periods].
    frequencies: tuple[float, float] = (5.0, 300.0)
    dampings: tuple[float, float] = (0.05, 3.0)
    frictions: tuple[float, float] = (0.003, 0.5)
    delays: float = 3.5
    #: Longest part of an interval in the simulation [s], and the angle by which the natural frequency turns in a part.
    #: The motion in ticks corrects the error of the parts.
    tick: float = 4e-3
    angle: float = 0.2
    #: A gap [s] after which the goal in between is unknown, so that the motion starts again.
    gap: float = 0.25
    #: Largest distance of the inertia from its start, as a logarithm. A start without ki may lose the inertia, so that
    #: the slowest servo of the ranges is permitted too. Least armature over the known load: less matters as little.
    far: float = 5.0
    least_armature: float = 0.01
    # lags
    #: Lags of the velocity in a loop at which the fit is tried first [s], and the standard deviation of the lag.
    lags: tuple[float, ...] = (0.0, 0.5e-3, 1e-3, 2e-3, 4e-3, 7e-3, 11e-3)
    lag: float = 5e-3
    #: Lags next to the best one differ by less than this log evidence, after halvings of their distance. Lags beyond
    #: the one that differs by eight times as much are left out.
    lag_drop: float = 1.5
    halvings: int = 3
    # values
    #: Half length of a 95 % interval of a normal distribution, in standard deviations.
    normal: float = 1.96
    #: Least standard error relative to the value: a loop in continuous time differs from one in ticks by this part.
    least_error: float = 1e-3
    # fit
    #: So much of each log is used [s].
    longest: float = 120.0
    #: A parameter is not determined from this relative standard error on.
    open: float = 0.5
    #: Samples that a fit needs for each parameter.
    samples_each: int = 10
    #: The model is doubted from this deviation on, or from this wandering part of it on, in standard deviations of the
    #: rounding. The ticks and counts of a servo in the table make a smaller one.
    noisy: float = 3.0
    wander: float = 0.5
    #: Part of the time at which the torque is limited, from which on a limit hides the other parameters.
    limited: float = 0.2
    # sysid
    #: Part of a gain whose error does not matter.
    negligible: float = 0.02
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
    # exports
    #: Step of the exported model of MuJoCo [s].
    mujoco_step: float = 1e-3
    #: Gravity is that of a mass within this distance of the axis [m]. A joint without gravity has the least mass [kg].
    longest_arm: float = 0.1
    least_mass: float = 1e-6
    #: Inertia of a body without its armature, as a part of the joint's inertia. MuJoCo refuses a body of none.
    least_inertia: float = 1e-3


TUNING = ActuatorTuning()
