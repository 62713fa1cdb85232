"""What is added in the place that ARCHITECTURE.md names reaches every other place, or a test here says where it does
not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import pmfid
from pmfid.cli.monitor import monitor
from pmfid.monitor.calibration import Calibration, Tail
from pmfid.monitor.detectors import Cusum, Detector, make_detectors
from pmfid.monitor.names import DETECTORS
from pmfid.monitor.scores import Scale
from pmfid.report.monitored_figures import calibration_figure
from pmfid.session.config import MonitorConfig
from pmfid.session.monitored import cache

TAIL = Tail(1.0, 1.0, 1.0, 10.0, (3.0, 2.0))


def bcrls() -> pmfid.BCRLS:
    return pmfid.BCRLS(pmfid.Drive(2.0), pmfid.Encoder(1e-4), 0.01, 30.0, forgetting=0.99)


# --- a detector -------------------------------------------------------------------------------------------------------


def test_every_detector_is_made_and_every_file_and_option_may_name_it() -> None:
    assert set(make_detectors(0.9)) == set(DETECTORS)
    (option,) = (parameter for parameter in monitor.params if parameter.name == "detector")
    assert tuple(option.to_info_dict()["type"]["choices"]) == DETECTORS
    for name in DETECTORS:
        assert MonitorConfig(detector=name).detector == name


@dataclass(frozen=True)
class Slower(Cusum):
    """One more."""

    name: ClassVar[str] = "slower"  # type: ignore[misc]


@pytest.mark.parametrize("further", [{"slower": Slower()}, {"cusum": Cusum(drift=0.7)}])
def test_thresholds_of_other_detectors_are_not_those_of_these(
    further: dict[str, Detector], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file from before a detector was added, or tuned anew, is no calibration of it: it would have no threshold."""

    def made(*_: object, **__: object) -> Calibration:
        scale = Scale(*(np.ones(3) for _ in Scale.__dataclass_fields__))
        return Calibration(np.ones(3), scale, (), dict.fromkeys(cache.make_detectors(0.9), TAIL), np.ones(3), 1.0)

    def get() -> tuple[Calibration, bool]:
        found, _, cached = cache.cached_calibration(bcrls(), np.ones(3), np.ones(9), None, 1.0)
        return found, cached

    monkeypatch.setenv("PMFID_CACHE", str(tmp_path))
    monkeypatch.setattr(cache, "calibrate", made)
    old = get()[0]
    assert get()[1]
    monkeypatch.setattr(cache, "make_detectors", lambda keep: make_detectors(keep) | further)
    found, cached = get()
    assert not cached
    assert set(further) - set(old.tails) <= set(found.tails)
    assert get()[1]


def test_the_figure_of_thresholds_leaves_no_detector_out() -> None:
    names = [f"detector {i}" for i in range(9)]
    figure = calibration_figure(dict.fromkeys(names, TAIL), names[0], 24.0)
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[:9] == [f"{names[0]} (in use)", *names[1:]]
