"""Thresholds, limits and counts of `pmfid.stream`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class StreamTuning:
    """All thresholds of `pmfid.stream`, ordered by module."""

    # commands
    #: Largest number of waiting commands.
    commands_most: int = 1000

    # engine
    #: Largest number of waiting deliveries, and of items in them. Above this number, the sources wait.
    engine_most: int = 8192
    #: Number of items that the engine takes together, apart from the items of the last delivery. An array of this
    #: number of items fits into the processor's cache. More items would be stepped more slowly, and a backlog would
    #: remain.
    at_once: int = 1024
    #: Time over which deliveries are collected [s]. Arrays fill within this time, and the delay remains invisible.
    engine_tick: float = 0.025
    #: Time between two tests for commands while no delivery arrives [s].
    engine_idle: float = 0.1
    #: Limits of latency above which slower deliveries are counted [s].
    engine_slow: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)

    # groups
    #: Number of consecutive lines before the window that reveal a clock set back.
    most_late: int = 5
    #: Number of consecutive samples after lines of another period until samples are used again.
    groups_probation: int = 50
    #: Largest number of waiting lines, and number of last lines whose repetition after a restart is recognised.
    groups_most: int = 100_000
    groups_known: int = 1000
    #: Number of notices of a kind, such as bad lines and gaps, that an axis gets one by one. Each later notice comes
    #: after twice as many events as the preceding notice.
    each_notice: int = 10

    # notices
    #: Smallest number of a service's notice, beyond the numbers of all axes, in microseconds since 1970. `of_axis` is
    #: the number of notices reserved for each axis.
    notices_own: int = 10**15
    of_axis: int = 10**9
    #: Time between two tests [s], and the longest counted pause of the engine [s]. No data can come while the process
    #: is stopped.
    notices_look: float = 1.0
    longest_pause: float = 5.0
    #: Number of sample periods for which an axis may be silent, even above a short limit.
    notices_periods: float = 5.0
    #: Largest number of axes that get their own alarm if they fall silent between two tests. More axes share one alarm.
    #: No alarm names more axes.
    notices_most: int = 100

    # order
    #: Largest deviation of a clock that was not set [s]. Time stamps may have a resolution of whole seconds.
    order_set: float = 1.5
    #: Least number of samples and shortest time [s] of a clock measurement, and the tolerance of the clock's rate.
    rate_samples: int = 500
    rate_time: float = 60.0
    order_rate: float = 0.005
    #: Tolerance of the sender's sample period, relative to the period of the configuration.
    order_period: float = 1e-3
    #: Longest gap between two epochs [s], and longest gap between two numbers [s]. A sender that skips more numbers has
    #: restarted.
    longest_gap: float = 3600.0
    longest_absence: float = 86400.0
    #: Number of remembered gaps, which distinguish late samples from repeated ones.
    order_gaps: int = 32
    #: Time without a new sample after which a sender is reported [s]. No broker repeats samples for a longer time.
    nothing_new: float = 120.0

    # outcome
    #: Largest number of kept alarms. Above this number, the oldest acknowledged or finished alarm goes first.
    outcome_most: int = 2000

    # store
    #: Time for which another writer or reader may hold the file [s]. States of a million axes take seconds.
    store_busy: float = 60.0
    #: Largest number of bytes in one value of the database. SQLite takes at most 10^9.
    store_piece: int = 2**26


TUNING = StreamTuning()
