"""A fleet of axes with edge times: the bits of single monitors, saved states, and input that is wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pmfid.monitor import MonitorFleet
from pmfid.monitor.events import Alarm
from tests.test_monitor_edges import changed_run, make_monitor

#: Runs of four axes: a change, normal work with a rest, lost samples, and instants that are wrong.
AXES = 4


@pytest.fixture(scope="module")
def runs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return u, counts and ages (AXES, n)."""
    rests = changed_run("mass", 1.0, seed=4, rest=400)
    singles = [changed_run("mass", 1.1), rests, changed_run("coulomb_friction", 1.3, seed=5), rests]
    u, counts, ages = (np.stack([part[-2400:] for part in parts]) for parts in zip(*singles, strict=True))
    u[2, 400] = u[2, 900:905] = np.nan
    ages[3, 500:1500:7] = np.resize([-1.0, np.inf, 1e300, 0.5], ages[3, 500:1500:7].size)
    return u, counts, ages


def batches(runs: tuple[np.ndarray, ...], size: int) -> Iterator[tuple[np.ndarray, ...]]:
    for start in range(0, runs[0].shape[1], size):
        yield tuple(np.ascontiguousarray(part[:, start : start + size]) for part in runs)


def test_a_fleet_has_the_bits_of_single_monitors(runs: tuple[np.ndarray, ...]) -> None:
    fleet = MonitorFleet(make_monitor(), AXES)
    found, events = [], [[] for _ in range(AXES)]
    for part in batches(runs, 333):
        found.append(fleet.run(np.arange(AXES), *part))
        for row, _, event in found[-1].events:
            events[row].append(event)
    for axis in range(AXES):
        monitor = make_monitor()
        expected = monitor.run(*(part[axis] for part in runs))
        for name in ("theta", "std", "status", "innovation", "state"):
            own = np.concatenate([getattr(rows, name)[axis] for rows in found])
            np.testing.assert_array_equal(own, getattr(expected, name)[0], err_msg=f"{name} of axis {axis}")
        assert repr(events[axis]) == repr([event for *_, event in expected.events])
        assert fleet.monitor(axis).get_state() == monitor.get_state()
    assert [any(isinstance(event, Alarm) for event in own) for own in events] == [True, False, True, False]


def test_a_fleet_goes_on_from_its_saved_states(runs: tuple[np.ndarray, ...]) -> None:
    first, second = (tuple(part[:, cut] for part in runs) for cut in (slice(0, 1205), slice(1205, None)))
    fleet, resumed = MonitorFleet(make_monitor(), AXES), MonitorFleet(make_monitor(), AXES)
    fleet.run(np.arange(AXES), *first)
    resumed.set_state(fleet.get_state())
    fleet.remove([0])
    expected = fleet.run([0, 1, 2], *(part[1:] for part in second))
    assert list(resumed.remove([0])) == [-1, 0, 1, 2]
    order = np.array([2, 0, 1])
    found = resumed.run(order, *(part[1:][order] for part in second))
    np.testing.assert_array_equal(found.theta, expected.theta[order])
    assert resumed.get_state() == fleet.get_state()
    assert resumed.refer(0)[0].theta.tolist() == expected.theta[0, -1].tolist()
