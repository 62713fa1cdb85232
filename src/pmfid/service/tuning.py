"""Thresholds, limits and counts of `pmfid.service`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class ServiceTuning:
    """One value for each decision of `pmfid.service`, by module."""

    # arrangement
    #: Time between two reports on the progress of a calibration [s].
    arrangement_progress: float = 10.0
    #: Number of last configurations that are compared with new ones, and number that is kept.
    arrangement_recent: int = 100
    arrangement_most: int = 1000

    # board.board
    #: Notices that are kept, and rows that wait for a viewer of an axis.
    board_notices: int = 2000
    board_waiting: int = 50_000

    # board.panel
    #: Points of a trend; first and longest interval of a point [s], which makes a trend of a day; fewest rows in an
    #: interval, because with about one row some points would be empty.
    panel_points: int = 90
    panel_finest: float = 2.0
    panel_coarsest: float = 1024.0
    panel_rows: float = 2.0
    #: Rows of an axis that are kept at least and at most.
    panel_fewest: int = 4
    panel_most: int = 20_000

    # keeping
    #: Deliveries that wait for a checkpoint at most: brokers have no more than 65535 messages under way.
    keeping_most: int = 50_000
    #: Shortest pause after a checkpoint, in multiples of the time to write it: with many axes a checkpoint has hundreds
    #: of MB, and its checksum and its copies take processor time.
    keeping_rest: float = 4.0
    #: New memory of more bytes is made by the writer's thread before the first checkpoint that needs it: it is much
    #: slower than a copy to memory that was used before, and the engine would stand still for seconds.
    keeping_large: int = 2**24

    # plant
    #: More axes than one process can serve.
    most_axes: int = 1_000_000

    # process
    #: Time between two calls that shows a stopped process [s]: no load delays them as long.
    process_stood: float = 10.0

    # run
    #: Pauses after an unexpected error [s]: the first, and the longest.
    run_first_pause: float = 1.0
    run_longest_pause: float = 60.0
    #: How often signals are looked at, and how long sources and sinks have to end [s].
    run_look: float = 0.1
    run_ending: float = 10.0
    #: Names that a notice lists at most.
    most_names: int = 100
    #: Objects after which garbage is looked for: blocks come and go by tens of thousands, without circles.
    run_collected: int = 50_000
    #: Time since its last tick after which the engine no longer counts as alive [s].
    run_stuck: float = 60.0

    # sinks.mqtt
    #: s that the broker has to take the connection, and to acknowledge what was published.
    mqtt_answer: float = 10.0
    #: Rows of one message where many axes share it.
    mqtt_batch: int = 500

    # sinks.queued
    #: Pauses after errors [s]: the first, the longest, and how long a sink must have worked to begin with the first
    #: again.
    queued_first_pause: float = 0.5
    queued_longest_pause: float = 60.0
    queued_steady: float = 60.0
    #: Shortest time between two notices on a slow sink [s].
    tell_every: float = 60.0
    #: s after which `put` is called with nothing, so that a sink sees that its connection has ended, or its file is
    #: old.
    queued_idle: float = 5.0
    #: Most different problems with refused outcomes that are reported.
    most_refusals: int = 10

    # sinks.sqlite
    #: s that another process may hold the file.
    sqlite_busy: float = 5.0

    # sinks.webhook
    #: Bytes of an answer that are read.
    most_answer: int = 1 << 16
    #: Notices that are remembered as delivered, while others of the same time are tried again.
    webhook_remembered: int = 2048

    # sources.execd Interval of the checks for the end of the service while no data arrive [s].
    execd_look: float = 0.2

    # sources.file
    #: How often a file is looked at that does not grow [s].
    file_look: float = 0.1
    #: Duration of the blocks of a played record [s], and most samples of a block.
    block_time: float = 0.05
    file_block: int = 1000
    #: Limits of the speed at which a record is played.
    file_slowest: float = 0.001
    file_fastest: float = 1e6

    # sources.serial
    #: Time without a byte that ends a read [s].
    serial_silence: float = 0.1

    # web.api
    #: Trends that one request may ask for, and characters of a note.
    api_trends: int = 200
    api_note: int = 500
    #: Rows of a reference record that are shown at most.
    api_rows: int = 50_000

    # web.connection
    #: Time for a TLS handshake [s], and a pause where the system has no file left for a connection [s].
    connection_handshake: float = 5.0
    #: Time for a whole request [s], and time without a byte read by a browser that something waits for [s].
    connection_request: float = 10.0
    connection_stuck: float = 10.0
    no_file: float = 0.1

    # web.hub
    #: Time between two looks at the board [s]; number of looks between two overviews, and between two of many axes.
    hub_tick: float = 0.25
    hub_overview: int = 2
    overview_of_many: int = 4
    hub_many: int = 2000
    #: Pieces of an axis that wait for slow browsers: 15 s.
    hub_pieces: int = 60
    #: Notices that a line has at most.
    hub_notices: int = 300
    #: Different changes that are kept as they were written: browsers are few ticks apart.
    hub_written: int = 8

    # web.security
    #: Fewest characters of a configured token.
    security_shortest: int = 20
    #: Largest body of a request [bytes], and its longest duration [s].
    largest_body: int = 4096
    slowest_body: float = 5.0
    #: Most wrong tokens of an address within a window of time [s], and most addresses that are remembered.
    security_free: int = 10
    security_window: float = 60.0
    security_addresses: int = 4096

    # web.server
    #: Connections in addition to the streams: files, histories, metrics.
    server_further: int = 64
    #: Times until the page answers, and until it has ended [s].
    server_started: float = 10.0
    server_ended: float = 3.0
    #: Connections that the system may queue until they are accepted.
    server_backlog: int = 1024
    #: Send buffer of the system for each browser [bytes]; its default would be some megabytes.
    server_waiting: int = 262_144

    # wire.sender
    #: Messages under way that the broker has not acknowledged, where it does not ask for less.
    under_way: int = 100
    #: Answer of the broker to a message without a subscriber, which is lost.
    sender_nobody: int = 0x10
    #: Pause between two attempts to connect, at most [s].
    sender_longest_pause: float = 5.0


TUNING = ServiceTuning()
