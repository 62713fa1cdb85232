"""Estimates live in PlotJuggler: JSON in datagrams, for its UDP server with the parser "json"."""

from __future__ import annotations

import math
import socket
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmfid.service.counters import Counters
from pmfid.service.outcome import Kindred, Notice, Rows
from pmfid.service.sinks.plain import Row, as_json, single_rows
from pmfid.service.sinks.section import Host, SinkSection

__all__ = ["PlotJugglerSection", "PlotJugglerSink"]

Text = Annotated[str, Field(min_length=1)]


class PlotJugglerSection(SinkSection):
    """[sinks.NAME] with kind = "plotjuggler"."""

    events_wanted: ClassVar[frozenset[str] | None] = frozenset()

    kind: Literal["plotjuggler"] = Field("plotjuggler", description='"plotjuggler"')
    host: Text = Field("127.0.0.1", description="the name or address of the machine that PlotJuggler runs on")
    port: int = Field(9870, ge=1, le=65535, description="the port of its UDP server, 9870 if left out")
    largest: int = Field(1400, ge=200, le=65507, description="the bytes that a datagram may have, 1400 if left out")

    def make(self, name: str, context: Host) -> PlotJugglerSink:
        """The sink, not yet open."""
        return PlotJugglerSink(name, (self.host, self.port), self.largest, context.counters)


class PlotJugglerSink:
    """A datagram for each row: {"timestamp": s, "AXIS": {"mass": ..., "mass_std": ..., ...}}. Whether anyone listens
    makes no difference; a row that is too large for a datagram is dropped and counted as refused."""

    def __init__(self, name: str, address: tuple[str, int], largest: int, counters: Counters) -> None:
        self.name = name
        self._address, self._largest, self._counters = address, largest, counters
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Raises OSError where the name of the machine leads nowhere."""
        self.close()
        family, kind, protocol, _, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
        opened = socket.socket(family, kind, protocol)
        try:
            opened.connect(address)
        except OSError:
            opened.close()
            raise
        self._socket = opened

    def put(self, outcomes: list[Rows | Notice]) -> None:
        """Raises OSError where nothing can be sent."""
        for rows in outcomes:
            if isinstance(rows, Rows):
                for row in single_rows(rows):
                    self._send(_datagram(row, rows.group))

    def _send(self, data: bytes) -> None:
        if len(data) > self._largest:
            self._counters.add("pmfid_refused_total", sink=self.name)
        elif self._socket is None:
            raise OSError("it is not open")
        else:
            try:
                self._socket.send(data)
            except ConnectionRefusedError:  # of the datagram before: nobody listens at the moment
                return

    def close(self) -> None:
        """Datagrams that are sent are gone."""
        opened, self._socket = self._socket, None
        if opened is not None:
            opened.close()


def _datagram(row: Row, group: Kindred) -> bytes:
    """Values that are not finite are left out, as PlotJuggler knows no null."""
    values: dict[str, float] = {"u": row.u, "counts": row.counts, "innovation": row.innovation}
    for name, value, std in zip(group.names, row.theta, row.std, strict=True):
        values |= {name: value, f"{name}_std": std}
    values |= {"status": row.status}
    finite = {name: value for name, value in values.items() if math.isfinite(value)}
    stamp = {"timestamp": row.time} if math.isfinite(row.time) else {}
    return as_json({**stamp, row.axis: {**finite, "state": row.state}}).encode()
