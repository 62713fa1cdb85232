"""The kinds of sources and sinks by their names in PLANT.toml; each is imported when a plant uses it.

The class of a section is light to import; what `make` needs beyond it is imported there, and where that is an extra
which is missing, `make` raises UsageError with the command that installs it.
"""

from __future__ import annotations

from collections.abc import Callable

from pmfid.service.context import SourceSection
from pmfid.service.sinks.section import SinkSection

__all__ = ["REMOVED", "SINKS", "SOURCES"]


def _file() -> type[SourceSection]:
    from pmfid.service.sources.file import FileSource

    return FileSource


def _stdin() -> type[SourceSection]:
    from pmfid.service.sources.file import StdinSource

    return StdinSource


def _mqtt() -> type[SourceSection]:
    from pmfid.service.sources.mqtt import MqttSourceSection

    return MqttSourceSection


def _execd() -> type[SourceSection]:
    from pmfid.service.sources.execd import ExecdSection

    return ExecdSection


def _serial() -> type[SourceSection]:
    from pmfid.service.sources.serial import SerialSection

    return SerialSection


def _file_sink() -> type[SinkSection]:
    from pmfid.service.sinks.file import FileSinkSection

    return FileSinkSection


def _mqtt_sink() -> type[SinkSection]:
    from pmfid.service.sinks.mqtt import MqttSinkSection

    return MqttSinkSection


def _sqlite() -> type[SinkSection]:
    from pmfid.service.sinks.sqlite import SqliteSection

    return SqliteSection


def _webhook() -> type[SinkSection]:
    from pmfid.service.sinks.webhook import WebhookSection

    return WebhookSection


SOURCES: dict[str, Callable[[], type[SourceSection]]] = {
    "execd": _execd,
    "file": _file,
    "mqtt": _mqtt,
    "serial": _serial,
    "stdin": _stdin,
}
SINKS: dict[str, Callable[[], type[SinkSection]]] = {
    "file": _file_sink,
    "mqtt": _mqtt_sink,
    "sqlite": _sqlite,
    "webhook": _webhook,
}
_BY_TELEGRAF = "use the kind mqtt or file, which Telegraf reads for any database"
#: Removed kinds, and the programs or kinds that replace them.
REMOVED: dict[str, str] = {
    "arrow": _BY_TELEGRAF,
    "line_protocol": _BY_TELEGRAF,
    "opcua": "use the kind execd with Telegraf's inputs.opcua",
    "plotjuggler": "use the kind mqtt, to which PlotJuggler subscribes",
}
