"""The section [page] of PLANT.toml, with the address, the token and the memory of the page."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from pmfid.config.model import Name, Positive
from pmfid.config.toml_file import FileSection
from pmfid.errors import UsageError
from pmfid.service.broker import PLACE, Place, is_here

#: Address of the page without [page].
HERE, PORT = "127.0.0.1", 8127


class PageConfig(FileSection):
    """The section [page]. Without this section the page is on `HERE` and `PORT`.

    The key `token` names the place of the token, which never stands in this section.
    """

    enabled: bool = Field(True, description="false to run without a page")
    address: Name = Field(HERE, description=f'the address to listen on, for example "{HERE}"')
    port: int = Field(PORT, ge=0, le=65535, description="the port of the page; 0 chooses a free port")
    hosts: tuple[Name, ...] = Field(
        (),
        strict=False,
        description=f'the host names that browsers use for the page, for example ["hall.example:{PORT}"]',
    )
    token: Place | None = Field(None, repr=False, description=f"the place of the token, {PLACE}")
    history_mb: Positive = Field(64.0, description="the memory in MB for the history of the axes, for example 64.0")

    @property
    def local(self) -> bool:
        """Return whether only this machine can reach the address."""
        return is_here(self.address)

    @model_validator(mode="after")
    def _check_access(self) -> Self:
        if not self.local:
            self._check_remote()
        return self

    def _check_remote(self) -> None:
        """Check the two settings that an address for other machines needs."""
        where = f"other machines can reach [page] address = {self.address!r}"
        if not self.token:
            raise UsageError(
                f"{where}, so the page needs a token of your choice; name its file, for example token = "
                '"file:page.token", or its environment variable, token = "env:PMFID_TOKEN"'
            )
        if self.address in ("0.0.0.0", "::", "") and not self.hosts:
            raise UsageError(
                f"{where} under any host name; list the names that browsers use, for example hosts = "
                f'["hall.example:{self.port}"]: requests for other names are refused'
            )
