"""Estimates and alarms as line protocol of InfluxDB and Telegraf: to a file, standard output, TCP, UDP or HTTP."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from functools import lru_cache
from typing import Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, model_validator

from pmfid.errors import UsageError
from pmfid.service.outcome import Notice, Rows
from pmfid.service.secrets import secret
from pmfid.service.sinks.line_targets import FileTarget, HttpTarget, Target, TcpTarget, UdpTarget
from pmfid.service.sinks.plain import as_json, single_rows
from pmfid.service.sinks.posting import Poster, checked_address
from pmfid.service.sinks.section import Host, SinkSection
from pmfid.service.wire.line_protocol import format_line
from pmfid.session.model_config import Name, Positive
from pmfid.session.toml_file import shown

__all__ = ["LineProtocolSection", "LineProtocolSink"]

#: s since 1970 that fit into 64 bits of ns.
LARGEST_TIME = 9e9


class LineProtocolSection(SinkSection):
    """[sinks.NAME] with kind = "line_protocol"."""

    kind: Literal["line_protocol"] = Field("line_protocol", description='"line_protocol"')
    to: Name = Field(
        description='a file, "stdout", "tcp://host:port", "udp://host:port", or an address of http as '
        '"https://host:8086/api/v2/write?org=a&bucket=b"'
    )
    token_env: Name | None = Field(None, description="the environment variable with the token of InfluxDB")
    token_file: Name | None = Field(None, description="the file with the token of InfluxDB")
    ca: Name | None = Field(None, description="the file of certificates that are trusted, or leave it out")
    timeout_s: Positive = Field(10.0, description="the time in s for a whole exchange, for example 10.0")
    rows: bool = Field(True, description="true for estimates and notices, false for notices alone")
    largest: int = Field(1400, ge=100, le=65507, description="the bytes that a datagram may have, 1400 if left out")

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        if self.token_env and self.token_file:
            raise ValueError("token_env and token_file are both there; give one of them")
        return self

    def wants_rows(self) -> bool:
        """As configured."""
        return self.rows

    def make(self, name: str, context: Host) -> LineProtocolSink:
        """The sink, not yet open. Raises UsageError for an address or a token that is none."""
        return LineProtocolSink(name, context.name, self._target(f"[sinks.{name}]", context))

    def _target(self, label: str, context: Host) -> Target:
        if self.to == "stdout":
            return FileTarget(None)
        scheme = urlsplit(self.to).scheme if "://" in self.to else ""
        if scheme == "":
            return FileTarget(context.folder / self.to)
        if scheme in ("tcp", "udp"):
            return (TcpTarget if scheme == "tcp" else UdpTarget)(
                self._host_and_port(label), self.timeout_s, self.largest
            )
        token = secret(self.token_env, self.token_file, context.folder)
        address = checked_address(self.to, token, label)
        headers = {} if token is None else {"Authorization": f"Token {token}"}
        return HttpTarget(
            Poster(address, headers, self.timeout_s, None if self.ca is None else context.folder / self.ca)
        )

    def _host_and_port(self, label: str) -> tuple[str, int]:
        try:
            parts = urlsplit(self.to)
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port:
            raise UsageError(f'{label} to = {shown(self.to)} has no host and port; give them as "udp://127.0.0.1:8089"')
        return host, port


class LineProtocolSink:
    """Lines `pmfid,service=...,axis=...,config=...,state=... mass=1.07,mass_std=0.01,... TIME` for rows, and
    `pmfid_event,service=...,axis=...,event=... number=7i,...` for notices. The same points may come twice after an
    error or a restart: databases know them by tags and time."""

    def __init__(self, name: str, service: str, target: Target) -> None:
        self.name = name
        self._service, self._target = service, target

    def open(self) -> None:
        """Raises OSError where the target is not there."""
        self._target.close()
        self._target.open()

    def put(self, outcomes: list[Rows | Notice]) -> None:
        """Raises OSError where they cannot be written, and RefusedError where they are not taken."""
        lines = [line.encode() + b"\n" for one in outcomes for line in self._lines(one) if line]
        if lines:
            self._target.send(lines)

    def _lines(self, one: Rows | Notice) -> Iterator[str]:
        if isinstance(one, Notice):
            yield self._notice_line(one)
            return
        config = one.group.config
        keys = [_key(key) for name in one.group.names for key in (name, f"{name}_std")]
        for row in single_rows(one):
            values = (value for pair in zip(row.theta, row.std, strict=True) for value in pair)
            fields = [f"{key}{value!r}" for key, value in zip(keys, values, strict=True) if math.isfinite(value)]
            own = [
                f"{key}={value!r}"
                for key, value in (("u", row.u), ("innovation", row.innovation))
                if math.isfinite(value)
            ]
            own.append(f"counts={row.counts}i,status={row.status}i,number={row.number}i")
            # where the axis has no clock, the time is that of the server that stores it
            stamp = f" {nanoseconds(row.time)}" if abs(row.time) < LARGEST_TIME else ""
            yield f"{_head(self._service, config, row.axis, row.state)} {','.join(own + fields)}{stamp}"

    def _notice_line(self, notice: Notice) -> str:
        tags = {"service": self._service, "axis": notice.axis, "event": str(notice.what.get("event", ""))}
        fields: dict[str, float | int | bool | str] = {"number": notice.number}
        for key, value in notice.what.items():
            if key not in ("event", "number") and value is not None:
                fields[key] = value if isinstance(value, int | float | str) else as_json(value)
        wall = notice.wall if math.isfinite(notice.wall) else time.time()
        return format_line("pmfid_event", tags, fields, nanoseconds(wall))

    def close(self) -> None:
        """Ends the connection, or closes the file."""
        self._target.close()


def nanoseconds(seconds: float) -> int:
    """Whole microseconds: a number of seconds since 1970 has no more digits."""
    return 1000 * round(1e6 * seconds)


# Names come again in every row: they are escaped once, by the writer of whole lines, and lines are put together here.


@lru_cache(maxsize=1 << 16)
def _head(service: str, config: str, axis: str, state: str) -> str:
    """Measurement and tags."""
    tags = {"service": service, "config": config, "axis": axis, "state": state}
    return format_line("pmfid", tags, {"a": True}).removesuffix(" a=true")


@lru_cache(maxsize=1 << 12)
def _key(name: str) -> str:
    """The name of a field with the sign behind it; one of a parameter is never empty."""
    return format_line("a", {}, {name: True}).removeprefix("a ").removesuffix("true")
