"""The first start: the page before the calibrations, and axes as they are ready."""

from __future__ import annotations

import threading
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

from pmfid.service import arrangement
from pmfid.service.arrangement import Configurations
from pmfid.service.plant import load_plant
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import prepare
from pmfid.stream.outcome import Counters, Notice
from tests.service.collected import Collected
from tests.service.feed import file_as_input
from tests.service.test_serve import PLANT, Acting, folder  # noqa: F401 a fixture


def test_the_page_answers_before_the_calibration(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    path, ready, text = folder / "first.toml", threading.Event(), StringIO()
    path.write_text(PLANT.replace("enabled = false", "port = 0"))
    plant = load_plant(path)

    def prepare_late(*arguments: Any) -> object:
        assert ready.wait(20)
        return prepare(*arguments)

    monkeypatch.setattr(arrangement, "prepare", prepare_late)
    service = Service(lambda: plant, NoticeLog(text))

    def look() -> None:
        try:
            acting.until("serving")
            assert service._page is not None
            assert urlopen(f"{service._page.url}healthz", timeout=5).status == 200
            assert service._engine.awaited == {"x1"}
        finally:
            ready.set()
        acting.until("alarm")  # the pipe waited for its axis

    acting = Acting(service, text)
    with file_as_input(folder / "run.csv"):
        acting.run(look)
    assert not service._engine.awaited


def test_threads_calibrate_and_report_errors(folder: Path) -> None:  # noqa: F811
    good, bad, reported = folder / "axis.toml", folder / "other.toml", list[dict[str, Any]]()
    configs = (configurations := Configurations(reported.append)).read({"x1": good, "x2": bad})
    monitor = configs[bad].monitor.model_copy(update={"reference": "nowhere.csv"})
    configs[bad] = configs[bad].model_copy(update={"monitor": monitor})
    made = {path.name: one and one.setup.nominal.tolist() for path, one in configurations.calibrate(configs)}
    assert made == {"axis.toml": prepare(good).setup.nominal.tolist(), "other.toml": None}
    assert [one["config"] for one in reported if "nowhere.csv" in one.get("problem", "")] == ["other.toml"]


def test_data_of_an_axis_that_is_not_ready_are_counted_and_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    counters, outlet, reported = Counters(), Collected(), list[Notice]()
    engine = StreamEngine(counters, [outlet])
    monkeypatch.setattr(outlet, "notice", reported.append)
    engine.set_awaited(["x1"])
    block = Block("x1", 0, 0, 0.0, 0.01, np.zeros(3), np.zeros(3, np.int64))
    engine.process([Delivery("hall", (block, replace(block, axis="x9")))])
    dropped = {dict(labels)["reason"] for (name, labels), _ in counters.values().items() if "unusable" in name}
    assert dropped == {"calibrating", "axis"}
    engine.tick(0.0)
    assert ["x9" in notice.what["problem"] for notice in reported] == [True]
