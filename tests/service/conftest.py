"""One calibrated configuration for all tests of the service in a process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pmfid.service.groups import Prepared, prepare
from studies.monitoring.pipe import write_axis

#: Of simulated normal work: enough for thresholds that nobody relies on.
HOURS = 0.5


@pytest.fixture(scope="session")
def plant_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """axis.toml and its reference; calibrations of a few minutes, kept for the session."""
    place = tmp_path_factory.mktemp("plant")
    write_axis(place, 60.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PMFID_CACHE", str(place / "cache"))
        patch.setattr("pmfid.session.monitored.setup.simulated_hours", lambda hours: HOURS)
        yield place


@pytest.fixture(scope="session")
def prepared(plant_folder: Path) -> Prepared:
    """axis.toml, calibrated."""
    return prepare(plant_folder / "axis.toml")
