"""Passwords and tokens from the environment or from files; messages have their names, never themselves."""

from __future__ import annotations

import ipaddress
import os
import stat
from pathlib import Path

from pmfid.errors import UsageError

__all__ = ["is_here", "read_secret", "secret"]


def is_here(host: str) -> bool:
    """Whether what is sent to a host stays on this machine."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def secret(env: str | None, file: str | None, folder: Path) -> str | None:
    """A password or token from the environment or from a file in `folder`; None where neither is given. Raises
    UsageError where there is none, and for a file that everybody can read."""
    if env is not None:
        if env not in os.environ:
            raise UsageError(f"the environment variable {env} is not set; set it to the secret, or give a file")
        return os.environ[env]
    return None if file is None else read_secret(folder / file).rstrip("\r\n")


def read_secret(path: Path) -> str:
    """The text of a file that not everybody can read. Raises UsageError."""
    try:
        with path.open(encoding="utf-8") as stream:
            if os.name == "posix" and os.fstat(stream.fileno()).st_mode & stat.S_IROTH:
                raise UsageError(f"everybody on this machine can read the secret in {path}; run: chmod 600 {path}")
            return stream.read()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not plain text"
        raise UsageError(f"the secret in {path} cannot be read: {reason}; correct the name or its rights") from None
