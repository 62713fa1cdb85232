"""States of monitors survive another rounding of the nominal values, as by another processor or number of threads."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pmfid.monitor import Monitor
from pmfid.monitor.scores import Scale
from pmfid.pipeline.monitored import setup
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared, prepare
from pmfid.stream.outcome import Counters
from studies.monitoring.axis import INCREMENTS, changing

PACE = Pace(window=0.0, every=0.0)


def rounded_otherwise(prepared: Prepared) -> str:
    """Return the baseline of a computer with other last bits."""
    monitor = prepared.setup.monitor
    assert isinstance(monitor, Monitor)
    scale = monitor.calibration.scale
    inverse = scale.inverse * (1 + 4 * np.finfo(float).eps)
    calibration = replace(
        monitor.calibration,
        theta=np.nextafter(monitor.calibration.theta, np.inf),
        scale=Scale(inverse, scale.energy, scale.sigma),
    )
    text = json.loads(prepared.setup.baseline) | {"calibration": calibration}
    return json.dumps(text, default=_plain)


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value.__dict__


def state_of(prepared: Prepared, name: str) -> bytes:
    """Return the checkpoint of an engine after 500 samples of one axis."""
    engine, group = StreamEngine(Counters()), Group(prepared, PACE)
    group.add([name])
    engine.set_groups([group])
    u, counts = changing(Schedule(((0.0, CART),)), 5, INCREMENTS, 500 * CART_DT)
    engine.process([Delivery("test", [Block(name, 0, 0, 0.0, CART_DT, u, counts)])])
    return b"".join(draft(engine).chunks())


def test_a_state_keeps_its_nominal_values_and_thresholds(prepared: Prepared) -> None:
    baseline = rounded_otherwise(prepared)
    there = prepare(prepared.path, None, {prepared.digest: baseline})
    assert there.setup.baseline == baseline
    saved = read_snapshot(state_of(there, "x1")).groups[0]
    assert saved.baseline == baseline
    restored = saved.restore_group(there, PACE).fleet.monitor(0)
    assert isinstance(restored, Monitor)
    assert restored.samples == 500
    assert restored.calibration.theta.tolist() == there.setup.nominal.tolist() != prepared.setup.nominal.tolist()


#: Changes of AXIS.toml, each with another part in the baseline.
GAIN = "[estimator]\ngiven = { mass = 1.07 }"
CHANGES = {"counts": {}, "a gain": {"input_gain = 2.0": 'input_gain = "estimate"', "[estimator]": GAIN}}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_baseline_makes_the_same_monitor_without_a_calibration(
    prepared: Prepared, monkeypatch: pytest.MonkeyPatch, change: dict[str, str]
) -> None:
    path = prepared.path.with_name("changed.toml")
    text = prepared.path.read_text()
    for before, after in change.items():
        assert before in text
        text = text.replace(before, after)
    path.write_text(text)
    first = prepare(path)
    monkeypatch.setattr(setup, "calibrate", None)
    again = prepare(path, None, {first.digest: first.setup.baseline})
    one, other = first.setup.monitor, again.setup.monitor
    assert one.configuration_number == other.configuration_number
    assert again.setup.baseline == first.setup.baseline
    assert again.setup.reported.tolist() == first.setup.reported.tolist()
