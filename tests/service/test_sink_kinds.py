"""All kinds of sinks fit a section of PLANT.toml, and load their libraries only on use."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmfid.config.toml_file import FileSection, validate_sections
from pmfid.errors import UsageError
from pmfid.service.plant import SINKS
from tests.patience import PATIENCE
from tests.service.feed import Host, alarm, block, kindred, until
from tests.tuned import set_tuning

NEEDED: dict[str, dict[str, object]] = {
    "sqlite": {"path": "a.sqlite"},
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
    assert made.outlet("a", Host(tmp_path)).name == "a"
    with pytest.raises(UsageError, match=r"quue_rows is an unknown key; known are .*did you mean 'queue_rows'"):
        validate_sections(Whole, {"sink": {"kind": kind, **keys, "quue_rows": 5}})
    with pytest.raises(
        UsageError, match=r"queue_rows = 0: it should be greater than or equal to 1; give the largest number"
    ):
        validate_sections(Whole, {"sink": {"kind": kind, **keys, "queue_rows": 0}})
    descriptions = {name: field.description for name, field in section.model_fields.items()}
    assert [name for name, words in descriptions.items() if not words] == []


def test_no_sink_brings_a_heavy_library_before_it_is_used() -> None:
    program = "from pmfid.service.plant import SINKS\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(run.stdout)}
    assert "pydantic" in loaded
    assert not {"polars", "paho", "matplotlib", "scipy.stats", "starlette", "uvicorn"} & loaded


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="this system has no /proc, where nobody can make files")
def test_a_folder_that_nothing_can_be_written_to_is_reported_once_and_costs_only_what_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_tuning(monkeypatch, "pmfid.service.sinks.queued", queued_first_pause=0.001)
    host = Host(tmp_path)
    outlet = (
        SINKS["sqlite"]
        .model_validate({"path": "/proc/a", "kind": "sqlite", "queue_rows": 30, "queue_notices": 5})
        .outlet("a", host)
    )
    outlet.start()
    for number in range(1, 101):
        outlet.rows(block(kindred(3), number))
        outlet.notice(alarm(number))
    assert until(lambda: host.count("pmfid_sink_errors_total", sink="a") > 2)
    assert outlet.close(PATIENCE)
    assert host.reported[0]["works"] is False
    assert len(host.reported) <= 2, "and once more at the end"
    assert host.count("pmfid_sink_working", sink="a") == 0
    rows, notices = (host.count(f"pmfid_dropped_{what}_total", sink="a") for what in ("rows", "notices"))
    assert (rows, notices) == (0, 100)
