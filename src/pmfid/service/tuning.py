"""Thresholds, limits and counts of `pmfid.service`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class ServiceTuning:
    """All thresholds of `pmfid.service`, ordered by module."""

    # board.board
    #: Largest number of rows of an axis, or of its reference, for a browser.
    board_rows: int = 50_000
    #: Time after its last request for which a browser still looks at an axis [s].
    board_looking: float = 5.0

    # board.panel
    #: Number of points in a trend, and shortest and longest interval of a point [s], which makes a trend of a day.
    #: `panel_rows` is the least number of rows in an interval, because with about one row some points would be empty.
    panel_points: int = 90
    panel_finest: float = 2.0
    panel_coarsest: float = 1024.0
    panel_rows: float = 2.0
    #: Smallest number of kept rows of an axis.
    panel_fewest: int = 4

    # broker
    #: Time for a broker, the page, a source or a sink to answer or to end, and time between two reports on the progress
    #: of a calibration [s].
    answer: float = 10.0
    #: First and longest pause after errors of sources and sinks [s]. A sink that works for the longest pause begins
    #: with the first one again, and gets one notice on lost rows in this time.
    first_pause: float = 0.5
    longest_pause: float = 60.0

    # keeping
    #: Largest number of deliveries that wait for a checkpoint. Brokers have no more than 65535 messages in transit.
    keeping_most: int = 50_000
    #: Shortest pause after a checkpoint, in multiples of the time to write it. With many axes a checkpoint has hundreds
    #: of MB, and its checksum and its copies take processor time.
    keeping_rest: float = 4.0

    # plant
    #: Limit of the number of axes, above the number that one process can serve.
    most_axes: int = 1_000_000

    # run
    #: Number of objects after which garbage is collected. Blocks come and go by tens of thousands, without reference
    #: cycles.
    run_collected: int = 50_000
    #: Time since its last tick after which the engine no longer counts as alive [s].
    run_stuck: float = 60.0

    # sinks.mqtt
    #: Number of rows in one message that many axes share.
    mqtt_batch: int = 500

    # sinks.queued
    #: Time after which `put` is called with no outcomes [s], so that a sink notices a closed connection.
    queued_idle: float = 5.0

    # web.api
    #: Number of trends in one request, and number of characters in a note.
    api_trends: int = 200
    api_note: int = 500
    #: Largest number of notices in one answer.
    api_notices: int = 300

    # web.security
    #: Least number of characters of a configured token.
    security_shortest: int = 20
    #: Largest body of a request [bytes], and its longest duration [s].
    largest_body: int = 4096
    slowest_body: float = 5.0


TUNING = ServiceTuning()
