"""The examples of docs/wire.md are understood."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest
from pydantic import Field

from pmfid.config.toml_file import FileSection, validate_sections
from pmfid.service.plant import SINKS, SOURCES
from pmfid.service.sources.mqtt import MqttSourceSection
from pmfid.service.sources.stdin import StdinSource
from pmfid.service.web.config import PORT
from pmfid.service.wire.messages import LARGEST, MOST_POINTS, Messages
from pmfid.stream.blocks import MOST_SAMPLES
from pmfid.stream.delivery import Lines
from tests.service.test_lines import axis

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "wire.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "howto" / "service.md").read_text(encoding="utf-8")
SECTIONS = (MqttSourceSection, StdinSource)


class Plant(FileSection):
    sources: dict[str, MqttSourceSection | StdinSource] = Field(description="sources")


def test_the_sections_are_valid_and_every_kind_has_one() -> None:
    texts = [text for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL) if "[sources." in text]
    shown = [source for text in texts for source in validate_sections(Plant, tomllib.loads(text)).sources.values()]
    assert [type(source) for source in shown] == list(SECTIONS)
    commented = tomllib.loads(re.sub(r"^# (\w+ =)", r"\1", texts[0], flags=re.MULTILINE))
    assert validate_sections(Plant, commented).sources["hall"].address == ("127.0.0.1", 8883)


@pytest.mark.parametrize("form", ["JSON", "columns", "Telegraf"])
def test_the_samples_are_read(tmp_path: Path, form: str) -> None:
    found = {
        "JSON": re.findall(r"```json\n(\{\"axis.*?)```", PAGE, re.DOTALL),
        "Telegraf": re.findall(r"```json\n(\{\"fields.*?)```", PAGE, re.DOTALL),
        "columns": re.findall(r"one object of columns,\s`(.*?)`", PAGE, re.DOTALL),
    }
    (text,) = found[form]
    (lines,) = Messages({"x1": axis(tmp_path)}.get).items(text.encode())
    assert isinstance(lines, Lines)
    assert len(lines.lines) == (2 if form == "columns" else 1)
    assert all(line.u == 1.5 and not line.problem for line in lines.lines)


def test_limits_are_those_of_the_code() -> None:
    defaults = {name: field.default for name, field in MqttSourceSection.model_fields.items()}
    assert (defaults["receive_maximum"], defaults["keepalive"], defaults["session"]) == (20_000, 60, 86_400)
    assert defaults["largest"] == LARGEST == 2**20
    assert "| `largest` of the source | 1 MiB |" in PAGE
    assert f"n, number of samples: 1 to {MOST_SAMPLES} |" in PAGE
    assert f"at most {MOST_POINTS:_} samples".replace("_", " ") in PAGE.replace("\n", " ")
    rows = re.findall(r"^\| `(\w+)` of the source \| ([\d ]+) ", PAGE, re.MULTILINE)
    assert [(name, int(value.replace(" ", ""))) for name, value in rows[:1]] == [("receive_maximum", 20_000)]


@pytest.mark.parametrize(("heading", "kinds"), [("What comes in", SOURCES), ("What goes out", SINKS)])
def test_the_guide_has_every_kind_and_no_other(heading: str, kinds: Mapping[str, object]) -> None:
    (part,) = re.findall(rf"^## {heading}\n\n(.*?)\n\n", GUIDE, re.DOTALL | re.MULTILINE)
    assert sorted(re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE)) == sorted(kinds)


@pytest.mark.parametrize(
    "page", ["deploy/Containerfile", "docs/howto/service.md", "docs/wire.md", "examples/plant.toml"]
)
def test_the_port_is_that_of_the_code(page: str) -> None:
    ports = re.findall(r"127\.0\.0\.1:(8\d{3})\b", (ROOT / page).read_text(encoding="utf-8"))
    assert set(ports) == {str(PORT)}
