"""Thresholds, limits and counts of `pmfid.stream`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class StreamTuning:
    """One value for each decision of `pmfid.stream`, by module."""

    # commands
    #: Commands that wait at most, and the longest note [characters].
    commands_most: int = 1000
    longest_note: int = 2000

    # engine
    #: Most deliveries that wait, and most items in them: beyond, the sources wait.
    engine_most: int = 8192
    most_items: int = 8192
    #: Items that the engine takes at once, apart from those of the last delivery. They fit into the processor's cache;
    #: more items would be stepped more slowly, and a backlog would remain.
    at_once: int = 1024
    #: Time over which deliveries are collected [s]: it fills the arrays, and the delay does not show.
    engine_tick: float = 0.025
    #: Time between two looks at the commands while no delivery arrives [s].
    engine_idle: float = 0.1
    #: Limits of latency for which slower deliveries are counted [s].
    engine_slow: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)

    # groups
    #: Number of consecutive lines before the window that show a clock set back.
    most_late: int = 5
    #: Number of consecutive samples after lines of another period until samples are used again.
    groups_probation: int = 50
    #: Most lines that wait, and number of last lines that are recognised if a source repeats them after a restart.
    groups_most: int = 100_000
    groups_known: int = 1000
    #: Number of notices of a kind, such as bad lines and gaps, that an axis gets one by one. Later notices come after
    #: twice as many events each.
    each_notice: int = 10

    # intake
    #: Most names of tables whose seating is cached.
    intake_most_names: int = 2**17

    # notices
    #: Smallest number of a notice of the service: microseconds since 1970, beyond the numbers of all axes; and the
    #: number of notices reserved for each axis.
    notices_own: int = 10**15
    of_axis: int = 10**9
    #: Time between two tests [s]; longest counted pause of the engine [s], because no data could come while the process
    #: was stopped.
    notices_look: float = 1.0
    longest_pause: float = 5.0
    #: Sample periods for which an axis may be quiet, however short the limit is.
    notices_periods: float = 5.0
    #: Most axes that get an alarm each if they fall silent between two tests, beyond which they share one alarm; names
    #: in that alarm.
    notices_most: int = 100
    notices_most_names: int = 100

    # order
    #: Largest deviation of a clock that was not set [s]: stamps may have a resolution of whole seconds.
    order_set: float = 1.5
    #: Rate of the sender's clock compared with its numbers: fewest samples and shortest time [s] of a measurement, and
    #: the tolerance of the rate.
    rate_samples: int = 500
    rate_time: float = 60.0
    order_rate: float = 0.005
    #: Tolerance of the sender's sample period, relative to the period of the configuration.
    order_period: float = 1e-3
    #: Longest gap between two epochs [s], and most missing samples between two numbers.
    longest_gap: float = 3600.0
    most_missing: int = 2**40
    #: Gaps that are remembered, to distinguish late samples from repeated ones.
    order_gaps: int = 32
    #: Time without a new sample after which a sender is reported [s]: no broker repeats more.
    nothing_new: float = 120.0

    # outcome
    #: Alarms that are kept; beyond, the oldest that is acknowledged or over goes first.
    outcome_most: int = 2000


TUNING = StreamTuning()
