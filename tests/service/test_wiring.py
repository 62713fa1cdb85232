"""A reload names the sections that it does not apply."""

from __future__ import annotations

from pathlib import Path

from pmfid.service.plant import load_plant

AXIS = '[axes.x1]\nconfig = "cart.toml"\n'


def test_the_sections_that_a_reload_leaves_as_they_were_are_named(tmp_path: Path) -> None:
    place = tmp_path / "plant.toml"
    place.write_text(AXIS + '[sources.log]\nkind = "mqtt"\ntopics = ["a"]\n[sinks.db]\nkind = "mqtt"\n')
    before = load_plant(place)
    place.write_text(
        AXIS.replace("x1", "x2")
        + '[page]\nport = 0\n[sources.log]\nkind = "mqtt"\ntopics = ["b"]\n[sinks.db]\nkind = "mqtt"\n'
        + '[sinks.lines]\nkind = "mqtt"\n'
    )
    assert load_plant(place).unlike(before) == ["[page]", "[sources.log]", "[sinks.lines]"]
    assert load_plant(place).unlike(load_plant(place)) == []
    place.write_text(AXIS.replace("x1", "x2") + "[page]\n")
    assert load_plant(place).unlike(load_plant(place)) == []
