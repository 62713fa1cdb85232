"""Bearer tokens of two scopes: to read, or to read and write."""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest
from pathlib import Path

from pmfid.errors import UsageError
from pmfid.service.secrets import read_secret
from pmfid.service.web.config import PageConfig

__all__ = ["READ", "WRITE", "Tokens", "keep_token", "load_tokens"]

READ, WRITE = "read", "write"
#: Fewest characters of a configured token.
SHORTEST = 20


@dataclass(frozen=True)
class Tokens:
    """write: may do everything; read: may look, None where there is none; made: by this start rather than configured,
    so that the start line may show it. Neither is part of what is printed of this object."""

    write: str = field(repr=False)
    read: str | None = field(default=None, repr=False)
    made: bool = False

    def scope(self, header: str | None) -> str | None:
        """WRITE, READ, or None for an `Authorization` that opens nothing. The time it takes tells nothing about the
        tokens: digests of the same length are compared, all of them."""
        scheme, _, given = (header or "").partition(" ")
        found = None
        for scope, token in ((READ, self.read), (WRITE, self.write)):
            if _equal(given.strip(), token or "") and token:
                found = scope
        return found if scheme.lower() == "bearer" else None


def _equal(a: str, b: str) -> bool:
    return compare_digest(sha256(a.encode()).digest(), sha256(b.encode()).digest())


def load_tokens(config: PageConfig, folder: Path) -> Tokens:
    """Those that [page] names, or a new one; folder: that names of files count from. Raises UsageError."""
    write = _read_token("token", config.token_env, config.token_file, folder)
    read = _read_token("read_token", config.read_token_env, config.read_token_file, folder)
    if read and read == write:
        raise UsageError("[page] the token that reads is also the one that writes; choose two")
    return Tokens(write or secrets.token_urlsafe(32), read, made=not write)


def keep_token(token: str, folder: Path | None) -> str:
    """Where a token stands that this start has made and no log may hold: a sentence. folder: of the checkpoints; its
    file page.token is readable by the service's user alone."""
    if folder is None:
        return "the token of this start is shown on a terminal only: name your own with [page] token_file or token_env"
    path = folder / "page.token"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(file, "w", encoding="ascii") as stream:
            stream.write(f"{token}\n")
    except OSError as error:
        return f"{path} cannot be written: {error.strerror}; name a token of your own with [page] token_file"
    return f"open the page with #token=... after the address; the token of this start is in {path}"


def _read_token(name: str, variable: str | None, file: str | None, folder: Path) -> str | None:
    if variable is None and file is None:
        return None
    where = f"[page] {name}_env = {variable!r}" if variable else f"[page] {name}_file = {file!r}"
    try:
        token = os.environ.get(variable, "") if variable else read_secret(folder / str(file))
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    token = token.strip()
    if len(token) < SHORTEST or not token.isascii() or not token.isprintable() or " " in token:
        raise UsageError(
            f"{where} holds no token of {SHORTEST} or more letters and digits without spaces; make one with: "
            'python -c "import secrets; print(secrets.token_urlsafe(32))"'
        )
    return token
