"""The section [page] of PLANT.toml, with the address, the users and the memory of the page."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from pmfid.config.model import Name, Positive
from pmfid.config.toml_file import FileSection
from pmfid.errors import UsageError
from pmfid.service.broker import is_here

#: Address of the page without [page].
HERE, PORT = "127.0.0.1", 8127


class PageConfig(FileSection):
    """The section [page]. Without this section the page is on `HERE` and `PORT`.

    Keys that end in `_env` or `_file` name the tokens, which never stand in this section.
    """

    enabled: bool = Field(True, description="false for no page")
    address: Name = Field(HERE, description=f'the address to listen on, as "{HERE}"')
    port: int = Field(PORT, ge=0, le=65535, description="the port, 0 for any that is free")
    allow_remote: bool = Field(False, description="true to listen on another address than that of this machine alone")
    hosts: tuple[Name, ...] = Field(
        (), strict=False, description=f'the names by which browsers reach it, as ["hall.example:{PORT}"]'
    )
    token_env: Name | None = Field(None, description="the environment variable with the token that may write")
    token_file: Name | None = Field(None, description="the file with the token that may write")
    read_token_env: Name | None = Field(None, description="the environment variable with the token that only reads")
    read_token_file: Name | None = Field(None, description="the file with the token that only reads")
    certificate: Name | None = Field(None, description="a file with the certificate, for TLS")
    key: Name | None = Field(None, description="a file with the key of the certificate")
    history_mb: Positive = Field(64.0, description="the memory for the history of the axes in MB, for example 64.0")
    browsers: int = Field(256, ge=1, le=4096, description="how many streams may be open at once")

    @property
    def local(self) -> bool:
        """Return whether only this machine can reach the address."""
        return is_here(self.address)

    @model_validator(mode="after")
    def _check_access(self) -> Self:
        for scope in ("", "read_"):
            if getattr(self, f"{scope}token_env") and getattr(self, f"{scope}token_file"):
                raise UsageError(f"[page] {scope}token_env and {scope}token_file are both given; drop one of them")
        if bool(self.certificate) != bool(self.key):
            raise UsageError("[page] certificate and key belong together; give both, or neither")
        if not self.local:
            self._check_remote()
        return self

    def _check_remote(self) -> None:
        """Check the three settings that an address for other machines needs."""
        where = f"[page] address = {self.address!r} can be reached from other machines"
        if not self.allow_remote:
            raise UsageError(f"{where}; set allow_remote = true if that is meant, or use {HERE}")
        if not (self.token_env or self.token_file):
            raise UsageError(
                f"{where}, so the page needs a token of your choice; name its file, as "
                'token_file = "page.token", or its environment variable, with token_env'
            )
        if self.address in ("0.0.0.0", "::", "") and not self.hosts:
            raise UsageError(
                f"{where} by any name; list those that browsers use, as hosts = "
                f'["hall.example:{self.port}"]: requests for others are refused'
            )
