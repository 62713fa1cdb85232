"""The folder of the service's checkpoints."""

from __future__ import annotations

from typing import ClassVar

from pmfid.durable import vault

__all__ = ["Vault"]


class Vault(vault.CheckpointFolder):
    """The folder `[service] state`; one service at a time."""

    setting: ClassVar[str] = "[service] state"
    other: ClassVar[str] = "another service"
