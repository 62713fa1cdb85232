"""Checkpoints on disk, and crash points."""

from __future__ import annotations

from typing import ClassVar

from pmfid import durable as vault
from pmfid.durable import CRASH_AT, arm, crash_point

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


class Vault(vault.CheckpointFolder):
    """The folder `[service] state`; one service at a time."""

    setting: ClassVar[str] = "[service] state"
    other: ClassVar[str] = "another service"
