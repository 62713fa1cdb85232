"""States of monitors survive another rounding of the nominal values, as by another processor or number of threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid.monitor import Monitor
from pmfid.monitor.scores import Scale
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.checkpoint import draft, read_snapshot
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared
from pmfid.stream.outcome import Counters
from studies.monitoring.axis import INCREMENTS, changing
from tests.service.test_serve import PLANT, folder  # noqa: F401 a fixture
from tests.test_architecture import REPOSITORY

PACE = Pace(window=0.0, every=0.0)


def rounded_otherwise(prepared: Prepared) -> Prepared:
    """Return the configuration as a computer with other last bits calibrates it."""
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
    return prepared.take_baseline(json.dumps(text, default=_plain))


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
    there = rounded_otherwise(prepared)
    saved = read_snapshot(state_of(there, "x1")).groups[0]
    expected, restored = (saved.restore_group(one, PACE).fleet.monitor(0) for one in (there, prepared))
    assert isinstance(restored, Monitor)
    assert restored.samples == 500
    assert restored.get_state() == expected.get_state()
    assert restored.calibration.theta.tolist() == there.setup.nominal.tolist()


PROGRAM = """
import sys
from pmfid.cli.main import main
main(["serve", sys.argv[1], "--until-end", "--json"])
"""
SETTINGS = [
    {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "Sandybridge"},
    {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"},
]


@pytest.mark.long
def test_a_service_keeps_all_states_on_another_processor(folder: Path) -> None:  # noqa: F811
    """Each start calibrates again."""
    plant = folder / "moved.toml"
    plant.write_text(PLANT.replace("window = 0.0", 'window = 0.0\nstate = "moved"'))
    found = []
    for setting in SETTINGS:
        settings = {**os.environ, **setting}
        command = [sys.executable, "-W", "ignore", "-c", PROGRAM, str(plant)]
        with (folder / "run.csv").open() as pipe:
            done = subprocess.run(
                command, cwd=REPOSITORY, env=settings, stdin=pipe, capture_output=True, text=True, timeout=1200
            )
        reported = [json.loads(line) for line in done.stdout.splitlines()]
        found += [one for one in reported if one["event"] == "checkpoint"]
    assert [(one.get("restored"), one.get("fresh"), "changed" in one) for one in found] == [
        (0, 1, False),
        (1, 0, False),
        (1, 0, False),
    ]
