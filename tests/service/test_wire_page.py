"""What docs/wire.md shows is understood."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import Field

from pmfid.service.delivery import Lines
from pmfid.service.sources.execd import ExecdSection
from pmfid.service.sources.mqtt import MqttSection
from pmfid.service.sources.serial import SerialSection
from pmfid.service.wire.messages import Messages
from pmfid.service.wire.points import Readers
from pmfid.session.toml_file import FileSection, validated
from tests.service.test_lines import axis

PAGE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")
SECTIONS = (MqttSection, SerialSection, ExecdSection)


class Plant(FileSection):
    sources: dict[str, MqttSection | SerialSection | ExecdSection] = Field(description="sources")


def test_the_sections_are_valid_and_every_kind_has_one() -> None:
    texts = [text for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL) if "[sources." in text]
    shown = [source for text in texts for source in validated(Plant, tomllib.loads(text)).sources.values()]
    assert [type(source) for source in shown] == list(SECTIONS)
    commented = tomllib.loads(re.sub(r"^# (\w+ =)", r"\1", texts[0], flags=re.MULTILINE))
    assert validated(Plant, commented).sources["hall"].address == ("127.0.0.1", 8883)


@pytest.mark.parametrize("form", ["JSON", "columns", "line protocol"])
def test_the_samples_are_read(tmp_path: Path, form: str) -> None:
    found = {
        "JSON": re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL),
        "columns": re.findall(r"one object of columns, `(.*?)`", PAGE, re.DOTALL),
        "line protocol": re.findall(r"```\n(drive,axis.*?)```", PAGE, re.DOTALL),
    }
    (text,) = found[form]
    (lines,) = Messages(Readers({"x1": axis(tmp_path)})).items(text.encode())
    assert isinstance(lines, Lines)
    assert len(lines.lines) == (2 if form == "columns" else 1)
    assert all(line.u == 1.5 and not line.problem for line in lines.lines)


def test_limits_are_those_of_the_code() -> None:
    defaults = {name: field.default for name, field in MqttSection.model_fields.items()}
    assert (defaults["receive_maximum"], defaults["keepalive"], defaults["session"]) == (20_000, 60, 86_400)
    assert defaults["largest"] == 2**20
    rows = re.findall(r"^\| `(\w+)` of the source \| ([\d ]+) ", PAGE, re.MULTILINE)
    assert [(name, int(value.replace(" ", ""))) for name, value in rows[:1]] == [("receive_maximum", 20_000)]
