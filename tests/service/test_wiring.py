"""What a service is made of comes together: its log, the history of configurations, whether it is alive."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmfid.service.plant import load_plant

AXIS = '[axes.x1]\nconfig = "cart.toml"\n'


@pytest.mark.parametrize(
    ("section", "speaks"),
    [
        ("", False),
        ('[sources.telegraf]\nkind = "execd"\n', False),
        ('[sources.telegraf]\nkind = "execd"\npass_on = true\n', True),
        ('[sinks.lines]\nkind = "line_protocol"\nto = "stdout"\n', True),
        ('[sinks.lines]\nkind = "line_protocol"\nto = "estimates.lp"\n', False),
    ],
)
def test_where_lines_go_to_standard_output_the_log_does_not(tmp_path: Path, section: str, speaks: bool) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + section)
    assert load_plant(place).speaks is speaks
