"""All kinds of sinks fit a section of PLANT.toml, and load their libraries only on use."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmfid.config.toml_file import FileSection, validate_sections
from pmfid.service.plant import SINKS
from tests.refusals import refused
from tests.service.feed import Host

NEEDED: dict[str, dict[str, object]] = {
    "webhook": {"url": "https://example.org"},
}


@pytest.mark.parametrize("kind", SINKS)
def test_a_section_makes_a_sink_and_names_what_is_wrong(kind: str, tmp_path: Path) -> None:
    section = SINKS[kind]
    keys = NEEDED.get(kind, {})

    class Whole(FileSection):
        sink: section  # type: ignore[valid-type]

    made = section.model_validate({"kind": kind, **keys})
    assert made.make("a", Host(tmp_path)).name == "a"
    assert list(tmp_path.iterdir()) == [], "nothing is opened yet"
    words = r"kinds is an unknown key; known are .*did you mean 'kind'"
    refused((words, lambda: validate_sections(Whole, {"sink": {"kind": kind, **keys, "kinds": 5}})))
    descriptions = {name: field.description for name, field in section.model_fields.items()}
    assert [name for name, words in descriptions.items() if not words] == []


def test_no_sink_brings_a_heavy_library_before_it_is_used() -> None:
    program = "from pmfid.service.plant import SINKS\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(run.stdout)}
    assert "pydantic" in loaded
    assert not {"polars", "paho", "matplotlib", "scipy.stats", "starlette", "uvicorn"} & loaded
