"""An extra is imported on use; if it is missing, one sentence says what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pmfid.errors import UsageError
from pmfid.service.broker import BrokerSection
from pmfid.service.sources.mqtt import MqttSource, MqttSourceSection
from pmfid.service.sources.serial import SerialSection, SerialSource
from pmfid.service.wire.sender import Sender

LIBRARIES = {"paho", "serial"}


def test_sections_and_sources_are_imported_without_their_libraries() -> None:
    modules = ("sources.mqtt", "sources.serial", "sources.execd", "wire.sender")
    program = "\n".join(f"import pmfid.service.{module}" for module in modules)
    program += "\nimport sys\nprint(*{name.partition('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(run.stdout.split()) & LIBRARIES == set()
    assert "pmfid" in run.stdout.split()


def made(library: str) -> MqttSource | SerialSource:
    if library == "paho":
        return MqttSource("a", MqttSourceSection(kind="mqtt", topics=("a",)), {}.get, lambda what: None)
    section = SerialSection(kind="serial", port="nowhere", format="block")
    return SerialSource("a", section, {}.get, lambda what: None)


@pytest.mark.parametrize("library", ["paho", "serial"])
def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch, library: str) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(UsageError, match=r"needs \S+: pip install 'pmfid\[serve\]'$"):
        made(library).run(lambda delivery: True, None)
    if library == "paho":
        with pytest.raises(UsageError, match="pip install"):
            Sender("a", 0.01, BrokerSection(), folder=Path())
