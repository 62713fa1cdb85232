"""The points at which a test kills the service."""

from __future__ import annotations

from pmfid.durable.crash import CRASH_AT, arm, crash_point

__all__ = ["CRASH_AT", "POINTS", "arm", "crash_point"]

#: All points, in the order in which a block passes them.
POINTS = (
    "inbox.taken",
    "engine.ordered",
    "engine.stepped",
    "engine.reported",
    "checkpoint.made",
    "checkpoint.half",
    "checkpoint.written",
    "checkpoint.synced",
    "checkpoint.renamed",
    "checkpoint.durable",
    "ack",
    "acked",
)
