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
    #: Number of consecutive samples after lines of another period until samples are used again.
    groups_probation: int = 50
    #: Largest number of waiting lines, and number of last lines whose repetition after a restart is recognised.
    groups_most: int = 100_000
    groups_known: int = 1000
    #: Number of notices of a kind, such as bad lines and gaps, that an axis gets one by one. Each later notice comes
    #: after twice as many events as the preceding notice.
    each_notice: int = 10

    # lines
    #: Largest number of stored sets of field names for one axis. The limit is necessary, because names with different
    #: units in brackets make different sets.
    most_readings: int = 16
    #: Largest number of letters in a message on a received value.
    most_letters: int = 200
    #: Largest number of bytes in a line. A longer line is left out.
    longest_line: int = 65536
    #: Number of first lines that must contain the header.
    first_lines: int = 100

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
    #: No notice contains more names.
    most_names: int = 100

    # order
    #: Largest deviation of a clock that was not set [s]. Time stamps may have a resolution of whole seconds.
    order_set: float = 1.5
    #: Least number of samples and shortest time [s] of a clock measurement, and the tolerance of the clock's rate, also
    #: for the mean period of lines.
    rate_samples: int = 500
    rate_time: float = 60.0
    order_rate: float = 0.005
    #: Tolerance of the sender's sample period, relative to the period of the configuration.
    order_period: float = 1e-3
    #: Longest gap between two epochs or two times [s], after which a clock was set, and longest gap between two numbers
    #: [s]. A sender that skips more numbers has restarted.
    longest_gap: float = 3600.0
    longest_absence: float = 86400.0
    #: Time without a new sample after which a sender is reported [s]. No broker repeats samples for a longer time.
    nothing_new: float = 120.0

    # outcome
    #: Largest number of kept alarms, and of notices on the page. Above this number, the oldest acknowledged or finished
    #: alarm goes first.
    outcome_most: int = 2000

    # store
    #: Time for which another writer or reader may hold the file [s]. States of a million axes take seconds.
    store_busy: float = 60.0
    #: Largest number of bytes in one value of the database. SQLite takes at most 10^9.
    store_piece: int = 2**26

    # timeline
    #: Number of steps from line to line in a group. The next constant is the smallest relative difference between the
    #: mean step and the sample period that matters.
    timeline_steps: int = 25
    timeline_coarse: float = 0.05
    #: Longest step before a repeated line, which counts as no step [sample periods].
    timeline_doubled: float = 0.02
    #: Smallest part of regular steps in a group with a period, and largest distance of a regular step from their mean.
    timeline_regular: float = 0.8
    timeline_close: float = 0.25
    #: Largest deviation of the stamp of an expected sample [sample periods]. The limit is large because late stamps are
    #: more common than lost samples.
    timeline_near: float = 0.75
    #: Part of a stamp's deviation by which the grid moves.
    timeline_follow: float = 0.1
    #: Number of successive lines that reveal missing samples. `timeline_late` is the number of lines that reveal a
    #: clock that was set back. `timeline_late` is larger, because a logger that repeats its last lines resembles a
    #: clock that was set back.
    timeline_ahead: int = 2
    timeline_late: int = 5
    #: Shortest and longest step from a held line to the next line [sample periods]. Lines between the held line and the
    #: next line may be lost.
    timeline_soonest: float = 0.25
    timeline_latest: float = 10.0
    #: Number of remembered gaps, and of recent samples with which a late line is compared. They distinguish late
    #: samples from repeated ones.
    remembered: int = 32
    #: Number of successive lines without a valid time that end the run.
    most_strays: int = 1000


TUNING = StreamTuning()
