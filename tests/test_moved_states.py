"""A state moves through firmware, an estimator and a fleet back into firmware.

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
from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.groups import Prepared
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, changing
from tests.firmware.build import GCC, HERE, M7, Target, compiled, run

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
        self._program = compiled(folder, PREFIX, target, HERE / "moved.c", "-O0")

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


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(GCC, marks=GCC.needed, id=GCC.name),
        pytest.param(M7, marks=[M7.needed, pytest.mark.long], id=M7.name),
    ],
)
def test_a_state_goes_from_firmware_through_everything_and_back(
    prepared: Prepared, tmp_path: Path, target: Target
) -> None:
    u, counts = changing(Schedule(((0.0, CART),)), 5, INCREMENTS, 4 * LEG * CART_DT)
    legs = [(u[k : k + LEG], counts[k : k + LEG]) for k in range(0, 4 * LEG, LEG)]
    straight = fresh(prepared).run(u, counts).theta
    firmware = Firmware(fresh(prepared), tmp_path / "firmware", target)
    found = list[np.ndarray]()

    theta, state = firmware.run(None, *legs[0])  # 1: the drive
    found.append(theta)

    estimator = fresh(prepared)  # 2: Python
    estimator.set_state(state)
    found.append(estimator.run(*legs[1]).theta)

    fleet = pmfid.Fleet(estimator, 3)  # 3: a fleet
    tracks = fleet.run(*(np.tile(one, (3, 1)) for one in legs[2]), every=1)
    found.append(np.asarray(tracks.theta)[1])

    theta, _ = firmware.run(fleet.axis(1).get_state(), *legs[3])  # 4: the drive again
    found.append(theta)
    assert np.concatenate(found).tobytes() == np.ascontiguousarray(straight).tobytes()
