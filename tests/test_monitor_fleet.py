"""Many monitored axes in one process: the bits of a monitor alone, whatever the pieces; states saved and moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmfid import UsageError
from pmfid.monitor import Alarm, Monitor, MonitorFleet, Watch, calibrate
from pmfid.monitor.events import Event
from pmfid.monitor.rows import STATES
from pmfid.simulation import CART, Schedule
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, changing, make_riv, normal_work

THETA = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
SECONDS = 20.0


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    u, counts = normal_work(7, INCREMENTS, 0.2)
    calibration = calibrate(make_riv(INCREMENTS), THETA, u, counts, hours=4.0)
    return Monitor(make_riv(INCREMENTS, THETA), calibration, Watch())


@pytest.fixture(scope="module")
def records() -> tuple[Floats, Counts]:
    """(axes, n): an axis whose mass grows, one that stays, one with lost samples, and one whose counter wraps."""
    heavier = Schedule(((0.0, CART), (8.0, replace(CART, mass=1.3 * CART.mass))))
    parts = [changing(Schedule(((0.0, CART),)) if k else heavier, k, INCREMENTS, SECONDS) for k in range(4)]
    u, counts = (np.array([part[i] for part in parts]) for i in range(2))
    u[2, np.random.default_rng(1).random(u.shape[1]) < 0.01] = np.nan
    counts[3] = (counts[3] + 100) % 2**16
    return u, counts


def alone(monitor: Monitor, u: Floats, counts: Counts) -> list[tuple[object, ...]]:
    """What `step` says of each sample."""
    told = []
    for one, count in zip(u.tolist(), counts.tolist(), strict=True):
        estimate, events = monitor.step(one, count)
        told.append((estimate.theta.tolist(), estimate.theta_std.tolist(), estimate.innovation, estimate.status))
        told[-1] = (*told[-1], STATES.index(monitor.state), [shown(event) for event in events])
    return told


def shown(event: Event) -> str:
    return repr(event)


def in_pieces(fleet: MonitorFleet, u: Floats, counts: Counts, seed: int = 0) -> list[list[tuple[object, ...]]]:
    """The same of a fleet that gets random axes, in any order, with pieces of any length."""
    rng, done = np.random.default_rng(seed), np.zeros(len(u), int)
    told: list[list[tuple[object, ...]]] = [[] for _ in u]
    while np.any(left := u.shape[1] - done):
        index = rng.permutation(np.flatnonzero(left))[: rng.integers(1, len(u) + 1)]
        n = int(min(rng.integers(1, 120), left[index].min()))
        pieces = [np.array([part[axis, done[axis] : done[axis] + n] for axis in index]) for part in (u, counts)]
        rows = fleet.run(index, *pieces)
        events: dict[tuple[int, int], list[str]] = {}
        for row, sample, event in rows.events:
            events.setdefault((row, sample), []).append(shown(event))
        for row, axis in enumerate(index.tolist()):
            lists = [part[row].tolist() for part in (rows.theta, rows.std, rows.innovation, rows.status, rows.state)]
            told[axis] += [(*one, events.get((row, k), [])) for k, one in enumerate(zip(*lists, strict=True))]
        done[index] += n
    return told


def test_every_axis_has_the_bits_of_a_monitor_alone(monitor: Monitor, records: tuple[Floats, Counts]) -> None:
    u, counts = records
    fleet = MonitorFleet(monitor, 4)
    before = monitor.get_state()
    told = in_pieces(fleet, u, counts)
    for axis in range(4):
        single = MonitorFleet(monitor, 1).monitor(0)
        assert told[axis] == alone(single, u[axis], counts[axis])
        assert single.get_state() == fleet.monitor(axis).get_state()
        assert fleet.samples()[axis] == single.samples
        assert STATES[fleet.states()[axis]] == single.state
    assert monitor.get_state() == before
    assert any(row[-1] and "Alarm" in str(row[-1]) for row in told[0])


def test_a_saved_state_goes_on_with_the_same_bits(monitor: Monitor, records: tuple[Floats, Counts]) -> None:
    u, counts = records
    first = MonitorFleet(monitor, 4)
    index = np.arange(4)
    first.run(index, u[:, :900], counts[:, :900])
    second = MonitorFleet(monitor, 0)
    second.set_state(first.get_state())
    assert second.axes == 4
    one, other = (fleet.run(index, u[:, 900:], counts[:, 900:]) for fleet in (first, second))
    assert np.array_equal(one.theta, other.theta)
    assert str(one.events) == str(other.events)
    assert any(isinstance(event, Alarm) for _, _, event in one.events)
    assert first.get_state() == second.get_state()


def test_a_damaged_state_changes_nothing(monitor: Monitor) -> None:
    fleet = MonitorFleet(monitor, 2)
    state = fleet.get_state()
    for bad in (b"", state[:-1], state + b"0", state[:100] + b"x" + state[101:]):
        with pytest.raises(UsageError):
            fleet.set_state(bad)
        assert fleet.get_state() == state


def test_axes_come_and_go(monitor: Monitor, records: tuple[Floats, Counts]) -> None:
    u, counts = records
    fleet = MonitorFleet(monitor, 3)
    fleet.run([2, 1], u[:2, :300], counts[:2, :300])
    assert fleet.remove([0]).tolist() == [-1, 0, 1]
    assert fleet.add(2) == range(2, 4)
    assert fleet.samples().tolist() == [300, 300, 0, 0]
    with pytest.raises(UsageError, match="twice"):
        fleet.run([1, 1], u[:2], counts[:2])
    with pytest.raises(UsageError, match="there are 4 axes"):
        fleet.run([4], u[:1], counts[:1])
