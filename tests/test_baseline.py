"""States of monitors survive another rounding of the nominal values, as by another processor or number of threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from pmfid.fleet.shards import States, StreamPlan, StreamShard
from pmfid.monitor import Monitor
from pmfid.monitor.scores import Scale
from pmfid.pipeline.monitored.setup import Setup
from pmfid.simulation import CART_DT
from pmfid.stream.blocks import encode
from pmfid.stream.groups import Pace, Prepared, prepare
from tests.service.test_serve import PLANT, folder  # noqa: F401 a fixture
from tests.spark.streams import block_of
from tests.test_architecture import REPOSITORY

PACE = Pace(window=0.0, every=0.0)


def rounded_otherwise(prepared: Prepared) -> Prepared:
    """Return the configuration as a computer with other last bits calibrates it."""
    setup = prepared.setup
    assert isinstance(setup, Setup)
    scale = setup.calibration.scale
    inverse = scale.inverse * (1 + 4 * np.finfo(float).eps)
    calibration = replace(
        setup.calibration,
        theta=np.nextafter(setup.calibration.theta, np.inf),
        scale=Scale(inverse, scale.energy, scale.sigma),
    )
    text = json.loads(setup.baseline) | {"calibration": json.dumps(calibration.__dict__, default=_plain)}
    return prepared.take_baseline(json.dumps(text))


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value.__dict__


def shard_state(prepared: Prepared, name: str) -> bytes:
    shard = StreamShard(StreamPlan(prepared, PACE, 1), 0)
    shard.take([encode(block_of(name, 500 * CART_DT, seed=5))])
    return shard.save_state()


def test_the_digest_is_that_of_texts_and_bytes(plant_folder: Path, prepared: Prepared) -> None:
    other = rounded_otherwise(prepared)
    assert other.setup.nominal.tolist() != prepared.setup.nominal.tolist()
    assert other.digest == prepared.digest == prepare(plant_folder / "axis.toml").digest
    reference = plant_folder / "normal.csv"
    text = reference.read_text()
    try:
        reference.write_text(text.rstrip("\n") + "0\n")
        assert prepare(plant_folder / "axis.toml").digest != prepared.digest
    finally:
        reference.write_text(text)


def test_a_state_keeps_its_nominal_values_and_thresholds(prepared: Prepared) -> None:
    there = rounded_otherwise(prepared)
    body = shard_state(there, "x1")
    expected = States.from_bodies({0: body}, there.digest).monitor("x1", there, PACE)
    monitor = States.from_bodies({0: body}, prepared.digest).monitor("x1", prepared, PACE)
    assert isinstance(monitor, Monitor)
    assert monitor.get_state() == expected.get_state()
    assert monitor.calibration.theta.tolist() == there.setup.nominal.tolist()


def test_states_with_other_last_bits_join_and_move(prepared: Prepared, tmp_path: Path) -> None:
    """This is the recipe of the guide: states of a stream become those of a service, and those of a Python program."""
    bodies = {0: shard_state(prepared, "x1"), 1: shard_state(rounded_otherwise(prepared), "x2")}
    States.from_bodies(bodies, prepared.digest).write(tmp_path / "state", prepared, PACE)
    states = States.from_folder(tmp_path / "state", prepared.digest)
    assert states.axes == ["x1", "x2"]
    monitors = {name: states.monitor(name, rounded_otherwise(prepared), PACE) for name in states.axes}
    assert {monitor.samples for monitor in monitors.values()} == {500}
    again = States.from_monitors(monitors, prepared, PACE)
    assert again.monitor("x2", prepared, PACE).get_state() == monitors["x2"].get_state()


PROGRAM = """
import sys
from pmfid.pipeline.monitored import setup
setup.simulated_hours = lambda hours: 0.5
from pmfid.cli.main import main
main(["serve", sys.argv[1], "--until-end", "--json"])
"""
SETTINGS = [
    {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "SkylakeX"},
    {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"},
]


def test_a_service_keeps_all_states_on_another_processor(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    """Each start calibrates again, because it has a cache of its own."""
    plant = folder / "moved.toml"
    plant.write_text(PLANT.replace("window = 0.0", 'window = 0.0\nstate = "moved"'))
    found = []
    for k, setting in enumerate(SETTINGS):
        settings = {**os.environ, **setting, "PMFID_CACHE": str(tmp_path / f"cache-{k}")}
        command = [sys.executable, "-W", "ignore", "-c", PROGRAM, str(plant)]
        done = subprocess.run(command, cwd=REPOSITORY, env=settings, capture_output=True, text=True, timeout=1200)
        reported = [json.loads(line) for line in done.stdout.splitlines()]
        found += [one for one in reported if one["event"] == "checkpoint"]
        assert len(list((tmp_path / f"cache-{k}").iterdir())) == 1
    assert [(one.get("restored"), one.get("fresh"), "changed" in one) for one in found] == [
        (0, 1, False),
        (1, 0, False),
        (1, 0, False),
    ]
