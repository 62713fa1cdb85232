"""The kinds of sinks by their names in PLANT.toml; each is imported when a plant uses it."""

from __future__ import annotations

from collections.abc import Callable

from pmfid.service.sinks.section import SinkSection

__all__ = ["SINKS"]


def _arrow() -> type[SinkSection]:
    from pmfid.service.sinks.arrow import ArrowSection

    return ArrowSection


def _line_protocol() -> type[SinkSection]:
    from pmfid.service.sinks.line_protocol import LineProtocolSection

    return LineProtocolSection


def _mqtt() -> type[SinkSection]:
    from pmfid.service.sinks.mqtt import MqttSection

    return MqttSection


def _plotjuggler() -> type[SinkSection]:
    from pmfid.service.sinks.plotjuggler import PlotJugglerSection

    return PlotJugglerSection


def _sqlite() -> type[SinkSection]:
    from pmfid.service.sinks.sqlite import SqliteSection

    return SqliteSection


def _webhook() -> type[SinkSection]:
    from pmfid.service.sinks.webhook import WebhookSection

    return WebhookSection


#: Kind -> its section.
SINKS: dict[str, Callable[[], type[SinkSection]]] = {
    "arrow": _arrow,
    "line_protocol": _line_protocol,
    "mqtt": _mqtt,
    "plotjuggler": _plotjuggler,
    "sqlite": _sqlite,
    "webhook": _webhook,
}
