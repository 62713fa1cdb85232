"""The parts of a service work together: its log, the history of configurations, and its health."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmfid.errors import UsageError
from pmfid.service.plant import load_plant

AXIS = '[axes.x1]\nconfig = "cart.toml"\n'


@pytest.mark.parametrize(
    ("section", "speaks"),
    [
        ("", False),
        ('[sources.telegraf]\nkind = "execd"\n', False),
        ('[sources.telegraf]\nkind = "execd"\npass_on = true\n', True),
    ],
)
def test_where_lines_go_to_standard_output_the_log_does_not(tmp_path: Path, section: str, speaks: bool) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + section)
    assert load_plant(place).speaks is speaks


def test_the_sections_that_a_reload_leaves_as_they_were_are_named(tmp_path: Path) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + '[sources.log]\nkind = "file"\npath = "a.csv"\naxis = "x1"\n[sinks.db]\nkind = "sqlite"\n')
    before = load_plant(place)
    place.write_text(
        AXIS.replace("x1", "x2")
        + '[page]\nport = 0\n[sources.log]\nkind = "file"\npath = "b.csv"\naxis = "x1"\n[sinks.db]\nkind = "sqlite"\n'
        + '[sinks.lines]\nkind = "file"\npath = "estimates.jsonl"\n'
    )
    assert load_plant(place).unlike(before) == ["[page]", "[sources.log]", "[sinks.lines]"]
    assert load_plant(place).unlike(load_plant(place)) == []
    place.write_text(AXIS.replace("x1", "x2") + "[page]\n")
    assert load_plant(place).unlike(load_plant(place)) == []


@pytest.mark.parametrize(
    ("section", "problem"),
    [
        ('[sources.plc]\nkind = "opcua"\n', r"\[sources\.plc\] kind = 'opcua' was removed; .* inputs\.opcua"),
        ('[sinks.rows]\nkind = "arrow"\n', r"\[sinks\.rows\] kind = 'arrow' was removed; .* Telegraf"),
        ('[sinks.db]\nkind = "line_protocol"\n', "was removed; use the kind mqtt or file"),
        ('[sinks.plots]\nkind = "plotjuggler"\n', "was removed; use the kind mqtt, to which PlotJuggler subscribes"),
    ],
)
def test_a_kind_that_was_removed_names_what_does_it_now(tmp_path: Path, section: str, problem: str) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + section)
    with pytest.raises(UsageError, match=problem):
        load_plant(place)
