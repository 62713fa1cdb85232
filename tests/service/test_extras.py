"""An extra is imported on use; if it is missing, one sentence says what to install."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pmfid.service.sources.mqtt import MqttSource, MqttSourceSection
from tests.refusals import refused


def test_sections_and_sources_are_imported_without_their_libraries() -> None:
    modules = ("sources.mqtt", "sources.stdin", "sinks.mqtt")
    program = "\n".join(f"import pmfid.service.{module}" for module in modules)
    program += "\nimport sys\nprint(*{name.partition('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "paho" not in run.stdout.split()
    assert "pmfid" in run.stdout.split()


def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "paho"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "paho", None)
    source = MqttSource("a", MqttSourceSection(kind="mqtt", topics=("a",)), {}.get, lambda what: None)
    refused((r"needs \S+: pip install 'pmfid\[serve\]'$", lambda: source.run(lambda delivery: True)))
