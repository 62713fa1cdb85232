"""OPC UA: nodes of a server, read together at a fixed period. asyncua, under the LGPL, is an extra of its own.

Either a value of each field of [record], where its time, if it is no node, is the latest that the server gives with
the values; or, with a node `number`, arrays that the controller has filled: samples numbered as blocks are, of which
none is missed as long as each is there for two periods.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, Literal, Self
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field, field_validator, model_validator

from pmfid.errors import UsageError
from pmfid.service.broker import Text, pauses
from pmfid.service.context import Axes, Context, SourceSection
from pmfid.service.delivery import Block, Delivery, Item, Mark, Unusable
from pmfid.service.secrets import is_here, secret
from pmfid.service.sources import Take
from pmfid.service.wire.blocks import problem_of
from pmfid.service.wire.layout import MOST_SAMPLES
from pmfid.service.wire.points import Point, Readers
from pmfid.session.toml_file import FileSection

if TYPE_CHECKING:
    from asyncua.client.client import Client
    from asyncua.ua.uatypes import DataValue

__all__ = ["OpcuaSection", "OpcuaSource"]

#: Fields of arrays: number of the first sample, input in the unit of the model, counts.
NUMBER, U, COUNTS = "number", "u", "counts"


class OpcuaAxis(FileSection):
    """[sources.NAME.axes.AXIS]: the nodes of one axis."""

    nodes: dict[str, Text] = Field(
        min_length=1, description='the node of each field, for example { u = "ns=2;s=drive.u", x = "ns=2;s=drive.x" }'
    )
    dt: float | None = Field(None, gt=0, description="the sample period in s of arrays, or leave it out without number")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (NUMBER in self.nodes) != (self.dt is not None):
            raise ValueError("dt is for arrays, which have a node number, and need it; give both, or neither")
        if self.dt is not None and set(self.nodes) != {NUMBER, U, COUNTS}:
            raise ValueError(f"arrays have the nodes {NUMBER}, {U} and {COUNTS}; correct the names")
        return self


class OpcuaSection(SourceSection):
    """[sources.NAME] of kind "opcua"."""

    kind: Literal["opcua"] = Field(description='"opcua"')
    url: Text = Field(description='the server, for example "opc.tcp://127.0.0.1:4840"')
    period: float = Field(0.1, ge=1e-3, le=3600, description="the seconds between two readings, for example 0.1")
    axes: dict[str, OpcuaAxis] = Field(min_length=1, description="a section for each axis with its nodes")
    user: Text | None = Field(None, description="the user's name, or leave it out")
    password_env: Text | None = Field(None, description="the environment variable that holds the password")
    password_file: Text | None = Field(None, description="the file that holds the password")
    allow_plain_password: bool = Field(False, description="true to send the password to another host without security")
    security: Text | None = Field(
        None, description='policy, mode, certificate and key: "Basic256Sha256,SignAndEncrypt,cert.pem,key.pem"'
    )

    @field_validator("url")
    @classmethod
    def _names_nobody(cls, url: str) -> str:
        """The address stands in messages."""
        if "@" in url:
            raise ValueError("it holds a user; give user, and password_env or password_file")
        return url

    @model_validator(mode="after")
    def _keeps_password(self) -> Self:
        if self.password_env and self.password_file:
            raise ValueError("password_env and password_file are both there; give one of them")
        if not (self.password_env or self.password_file):
            return self
        if not self.user:
            raise ValueError("there is a password without a user; give user")
        host = urlsplit(self.url).hostname or ""
        if self.security is None and not is_here(host) and not self.allow_plain_password:
            raise ValueError(
                f"the password would reach {host} unencrypted; give security; allow_plain_password = true accepts the "
                "risk"
            )
        return self

    def make(self, name: str, context: Context) -> OpcuaSource:
        """The source, not yet running. Raises UsageError without asyncua, and for a password that is not there."""
        source = OpcuaSource(name, self, context.axes, context.tell, context.folder)
        source.client()  # what is wrong with it is said at the start
        return source


@dataclass
class OpcuaSource:
    """A `Source` of nodes. name: in PLANT.toml; axes: by name; tell: takes what happens to the source; folder: that
    files in the section are relative to."""

    name: str
    section: OpcuaSection
    axes: Axes
    tell: Callable[[dict[str, Any]], None]
    folder: Path = Path()
    _stopped: Event = field(default_factory=Event, init=False)
    _told: str = field(default="", init=False)
    _mark: Mark = field(default_factory=dict, init=False)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Reads until `stop`; mark: epoch and last number of each axis with arrays. Raises UsageError for a section
        that cannot work, and without asyncua."""
        self._mark, waiting = dict(mark or {}), pauses()
        while not self._stopped.is_set():
            client = self.client()
            try:
                asyncio.run(self._connected(client, take))
                return
            except UsageError:
                raise
            except Exception as error:  # of asyncua, asyncio and sockets: all mean that nothing comes
                self._say(f"{self.section.url} cannot be read: {str(error) or type(error).__name__}")
                self._stopped.wait(next(waiting))

    def stop(self) -> None:
        """Ends `run` after the reading in hand."""
        self._stopped.set()

    def client(self) -> Client:
        """One that is not connected yet. Raises UsageError without asyncua, and for a password that is not there."""
        try:
            from asyncua.client.client import Client
        except ImportError:
            raise UsageError("OPC UA needs asyncua: pip install 'pmfid[opcua]'") from None
        section = self.section
        client = Client(section.url, timeout=10)
        if section.user is not None:
            client.set_user(section.user)
            client.set_password(secret(section.password_env, section.password_file, self.folder) or "")
        return client

    async def _connected(self, client: Client, take: Take) -> None:
        """Readings one period apart, until the source is stopped. Raises whatever ends the connection."""
        readers, section = Readers(self.axes), self.section
        if section.security is not None:
            await client.set_security_string(section.security)
        async with client:
            self._say("")
            nodes = [client.get_node(node) for axis in section.axes.values() for node in _listed(axis)]
            due = time.monotonic()
            while not self._stopped.is_set():
                values = await client.uaclient.read_attributes([node.nodeid for node in nodes], _value_attribute())
                items = self._items(list(values), readers)
                received = time.monotonic()
                delivery = Delivery(self.name, items, None, dict(self._mark) or None, received)
                if items and not await asyncio.to_thread(take, delivery):  # the session stays alive while it waits
                    self.stop()
                due = max(due + section.period, received)
                await asyncio.sleep(max(0.0, due - received))

    def _items(self, values: list[DataValue], readers: Readers) -> Sequence[Item]:
        items: list[Item] = []
        for name, axis in self.section.axes.items():
            own, values = values[: len(_listed(axis))], values[len(_listed(axis)) :]
            bad = [value.StatusCode for value in own if not (value.StatusCode and value.StatusCode.is_good())]
            if bad:
                items.append(Unusable("bad quality", f"a node of {name} is not good: {bad[0]}", name))
            elif axis.dt is None:
                items += readers.items([_point(name, axis, own)])
            else:
                items += self._block(name, axis, axis.dt, own)
        return items

    def _block(self, name: str, axis: OpcuaAxis, dt: float, own: list[DataValue]) -> list[Item]:
        """The block of arrays, if it is another than the last one, and the controller did not write meanwhile."""
        before, *values, after = (value.Value.Value if value.Value else None for value in own)
        if before is None or before != after or before == self._mark.get(f"{name}/number"):
            return []
        found = dict(zip([key for key in axis.nodes if key != NUMBER], values, strict=True))
        try:
            u, counts = np.array(found[U], np.float64), np.array(found[COUNTS], np.int64)
            first = int(before)
            block = Block(name, self._epoch(name, first), first, math.nan, dt, u, counts)
            if not (0 < u.size <= MOST_SAMPLES and u.shape == counts.shape == (u.size,)):
                raise ValueError(f"arrays of {u.shape} and {counts.shape}, not of 1 to {MOST_SAMPLES} samples each")
        except (TypeError, ValueError, OverflowError) as error:
            return [Unusable("length", f"the arrays of {name} are no samples: {error}", name)]
        self._mark |= {f"{name}/epoch": block.epoch, f"{name}/number": block.first}
        return [problem_of(block, u, counts) or block]

    def _epoch(self, name: str, number: int) -> int:
        """Numbers that go back begin anew."""
        epoch, last = (int(self._mark.get(f"{name}/{key}", 0)) for key in ("epoch", "number"))
        return epoch + (number < last)

    def _say(self, problem: str) -> None:
        """Tells a problem once, and its end."""
        if problem != self._told:
            self._told = problem
            self.tell({"event": "source", "source": self.name, "problem": problem})


def _listed(axis: OpcuaAxis) -> list[str]:
    """The nodes of an axis in the order in which they are read: a number first and last."""
    others = [node for key, node in axis.nodes.items() if key != NUMBER]
    return [axis.nodes[NUMBER], *others, axis.nodes[NUMBER]] if axis.dt is not None else others


def _point(name: str, axis: OpcuaAxis, own: list[DataValue]) -> Point:
    fields = {key: value.Value.Value if value.Value else None for key, value in zip(axis.nodes, own, strict=True)}
    stamps = [value.SourceTimestamp or value.ServerTimestamp for value in own]
    times = [stamp.replace(tzinfo=stamp.tzinfo or UTC).timestamp() for stamp in stamps if stamp is not None]
    return Point(name, fields, max(times, default=math.nan))


def _value_attribute() -> Any:
    from asyncua.ua.attribute_ids import AttributeIds

    return AttributeIds.Value
