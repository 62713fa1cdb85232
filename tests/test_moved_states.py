"""A state moves through firmware, an estimator, a watched fleet, a service and a fleet back into firmware.

The moves do not change the estimates.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.estimators.configuration import configuration_of, construct_estimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.export.firmware import export_firmware
from pmfid.fleet.shards import States, StreamPlan, StreamShard
from pmfid.monitor import Monitor
from pmfid.simulation import CART_DT
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from pmfid.stream.groups import Pace, Prepared
from pmfid.types import Counts, Floats
from tests.firmware.build import GCC, HERE, M7, Target, compiled, run
from tests.spark.streams import block_of

PACE = Pace(window=0.0, every=0.0)
PREFIX = "axis"
#: Samples of each stop.
LEG = 500


def fresh(prepared: Prepared) -> RecursiveEstimator:
    """Return the estimator of the watch at its start."""
    estimator = prepared.setup.monitor.estimator
    return construct_estimator(type(estimator), configuration_of(estimator))


class Firmware:
    """The exported estimator in a program for a target."""

    def __init__(self, estimator: RecursiveEstimator, folder: Path, target: Target) -> None:
        export_firmware(estimator, folder, prefix=PREFIX)
        self._folder, self._target, self._p = folder, target, len(estimator.names)
        self._real = np.float32 if estimator.precision == "float32" else np.float64
        self._program = compiled(folder, PREFIX, target, HERE / "moved.c", "-O2")

    def run(self, state: bytes | None, u: Floats, counts: Counts) -> tuple[np.ndarray, bytes]:
        """Return theta (n, p), and the saved state."""
        samples = np.zeros(u.size, np.dtype([("u", self._real), ("count", np.uint32)], align=True))
        samples["u"], samples["count"] = u, counts.astype(np.uint32)
        (self._folder / "in").write_bytes(samples.tobytes())
        (self._folder / "state").write_bytes(state or b"")
        done = run(self._program, self._target, "in", "state" if state else "-", "theta", "saved")
        assert done.returncode == 0, f"{done.returncode}: {done.stdout}{done.stderr}"
        theta = np.frombuffer((self._folder / "theta").read_bytes(), self._real).reshape(-1, self._p)
        return theta, (self._folder / "saved").read_bytes()


def needs(target: Target) -> pytest.MarkDecorator:
    return pytest.mark.skipif(bool(target.missing), reason=target.missing)


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(GCC, marks=needs(GCC), id=GCC.name),
        pytest.param(M7, marks=[needs(M7), pytest.mark.long], id=M7.name),
    ],
)
def test_a_state_goes_from_firmware_through_everything_and_back(
    prepared: Prepared, tmp_path: Path, target: Target
) -> None:
    motion = block_of("x1", 6 * LEG * CART_DT, seed=5)
    legs = [(motion.u[k : k + LEG], motion.counts[k : k + LEG]) for k in range(0, 6 * LEG, LEG)]
    straight = fresh(prepared).run(motion.u, motion.counts).theta
    firmware = Firmware(fresh(prepared), tmp_path / "firmware", target)
    found = list[np.ndarray]()

    theta, state = firmware.run(None, *legs[0])  # 1: the drive
    found.append(theta)

    estimator = fresh(prepared)  # 2: Python
    estimator.set_state(state)
    found.append(estimator.run(*legs[1]).theta)

    found.append(watched(prepared, estimator, legs[2:4], tmp_path))  # 3: a stream, then a service's checkpoint
    single = States.from_folder(tmp_path / "state", prepared.digest).monitor("x1", prepared, PACE).estimator

    fleet = pmfid.Fleet(single, 3)  # 4: a fleet
    tracks = fleet.run(*(np.tile(one, (3, 1)) for one in legs[4]), every=1)
    found.append(np.asarray(tracks.theta)[1])

    theta, _ = firmware.run(fleet.axis(1).get_state(), *legs[5])  # 5: the drive again
    found.append(theta)
    assert np.concatenate(found).tobytes() == np.ascontiguousarray(straight).tobytes()


def watched(
    prepared: Prepared, estimator: RecursiveEstimator, legs: list[tuple[Floats, Counts]], folder: Path
) -> np.ndarray:
    """Return theta of both legs: the first in a shard, the second in another shard that resumes from the service's
    folder.
    """
    monitor = monitor_of(prepared, estimator)
    states, found, plan = (
        States.from_monitors({"x1": monitor}, prepared, PACE),
        list[np.ndarray](),
        StreamPlan(prepared, PACE, 1),
    )
    for k, (u, counts) in enumerate(legs):
        shard = StreamShard(plan, 0, states.bodies(plan)[0])
        shard.take([encode(Block("x1", 0, k * LEG, k * LEG * CART_DT, CART_DT, u, counts))])
        assert shard.count_samples() == {"samples": LEG}
        found += [rows.theta for rows in shard.outcomes.estimates]
        States.from_bodies({0: shard.save_state()}, prepared.digest).write(folder / "state", prepared, PACE)
        states = States.from_folder(folder / "state", prepared.digest)
    return np.concatenate(found)


def monitor_of(prepared: Prepared, estimator: RecursiveEstimator) -> Monitor:
    """Return a restarted watch with the running estimator."""
    like = prepared.setup.monitor
    return Monitor(estimator, like.calibration, like.watch, like.known)
