"""A reference that a user sets by hand survives a restart, for the monitor and for the page."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from pathlib import Path

from pmfid.service.plant import Plant, ServiceSection, load_plant
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog
from tests.service.feed import file_as_input
from tests.service.test_serve import PLANT, Acting, folder  # noqa: F401 a fixture

Referred = list[dict[int, list[float]]]


def looked_at(plant: Plant, refer: bool = False) -> tuple[Referred, list[float]]:
    """Return the reference of x1 in the page and in the monitor, after a record with `refer`, or after no sample."""
    text, record = StringIO(), plant.folder / "run.csv"
    if not refer:
        header = record.read_text().partition("\n")[0]
        record = plant.folder / "header.csv"
        record.write_text(f"{header}\n")
    service = Service(lambda: plant, NoticeLog(text))
    found: list[tuple[Referred, list[float]]] = []

    def step() -> None:
        acting.samples(1600)
        if refer:
            assert service._engine.refer("x1")
            acting.until("reference")

    def look() -> None:
        acting.until("checkpoint")
        (group,) = service._engine.groups
        found.append((service._board.list_referred(), group.fleet.monitor(0).reference.tolist()))

    acting = Acting(service, text)
    with file_as_input(record):
        acting.run(*([step] if refer else []), look)
    return found[0]


def test_a_reference_set_by_hand_is_known_after_a_restart(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    (folder / "plant.toml").write_text(PLANT)
    plant = load_plant(folder / "plant.toml")
    kept = replace(plant, service=ServiceSection(state=str(tmp_path / "state"), window=0.0))
    shown, used = looked_at(kept, refer=True)
    assert shown[0][0] == used
    again, still = looked_at(kept)
    assert still == used
    assert again == shown, "the page forgot it"
